"use strict";
// The leaderboards: a table per scenario, sorted and filtered together.
(function (crowdbench) {
  const { element, fixed, link, twoSignificant } = crowdbench;
  // Kept while other views are shown.
  const chosen = { family: "", hidden: new Set(), all: false, sort: "success", reverse: false };

  crowdbench.cellValue = function (cell, metric) {
    const [mean, low, high] = cell.estimates[crowdbench.index.metrics.indexOf(metric)];
    if (mean === null) {
      const older = cell.not_computed.includes(metric.name);
      return element("td", { class: "number", title: older
        ? "The episodes are older than this metric; crowdbench recompute fills it in." : null,
      }, older ? "not computed" : "–");
    }
    // Decimals follow from the mean, also in the interval.
    const digits = metric.digits ?? twoSignificant(mean * metric.scale);
    const printed = (value) => fixed(value * metric.scale, digits);
    return element("td", { class: "number" }, printed(mean),
      low === null ? null : element("span", { class: "interval" }, `[${printed(low)}, ${printed(high)}]`));
  };

  crowdbench.metricHead = (metric) => [
    element("span", { class: "label" }, `${metric.label} ${metric.better === "higher" ? "↑" : "↓"}`),
    element("span", { class: "unit" }, metric.unit),
  ];

  crowdbench.shownMetrics = () =>
    crowdbench.index.metrics.filter((metric) => metric.main || chosen.all);

  function compare(a, b) {
    if (chosen.sort === "agent") return a.agent < b.agent ? -1 : a.agent > b.agent ? 1 : 0;
    if (chosen.sort === "episodes") return b.episodes - a.episodes;
    const { metrics } = crowdbench.index;
    const at = metrics.findIndex((metric) => metric.name === chosen.sort);
    const [x, y] = [a.estimates[at][0], b.estimates[at][0]];
    // What is undefined comes last, whichever way round.
    if (x === null || y === null) return ((x === null) - (y === null)) * (chosen.reverse ? -1 : 1);
    return metrics[at].better === "higher" ? y - x : x - y;
  }

  function head(key, content, title, redraw) {
    const sorted = chosen.sort === key;
    const sort = () => {
      chosen.reverse = sorted && !chosen.reverse;
      chosen.sort = key;
      redraw(key);
    };
    return element("th", {
      scope: "col", title, "data-sort": key, class: key === "agent" ? null : "number",
      "aria-sort": sorted ? (chosen.reverse ? "descending" : "ascending") : null,
    }, element("button", { type: "button", click: sort }, content));
  }

  function table(scenario, cells, redraw) {
    const metrics = crowdbench.shownMetrics();
    const rows = [...cells].sort(compare);
    if (chosen.reverse) rows.reverse();
    // What is incomplete is not ranked.
    rows.sort((a, b) => (a.missing > 0) - (b.missing > 0));
    return element("section", { class: "board", "data-scenario": scenario.label },
      element("h2", {}, scenario.label, " ", element("small", {}, scenario.family)),
      scenario.description ? element("p", { class: "note" }, scenario.description) : null,
      element("div", { class: "scroll", tabindex: "0", role: "region",
        "aria-label": "Leaderboard of " + scenario.label },
      element("table", {},
        element("thead", {}, element("tr", {},
          head("agent", element("span", { class: "label" }, "agent"), "Name and options", redraw),
          metrics.map((metric) =>
            head(metric.name, crowdbench.metricHead(metric), metric.definition, redraw)),
          head("episodes", element("span", { class: "label" }, "episodes"), "How many are stored", redraw),
          element("th", { scope: "col" }, "replay"))),
        element("tbody", {}, rows.map((cell) => element("tr", {},
          element("th", { scope: "row" },
            element("a", { href: link("agent", { name: cell.agent }) },
              crowdbench.name(cell.agent))),
          metrics.map((metric) => crowdbench.cellValue(cell, metric)),
          element("td", { class: "number" },
            String(cell.episodes) + (cell.missing ? `, incomplete: ${cell.missing} missing` : "")),
          element("td", {}, watch(cell))))))));
  }

  function watch(cell) {
    const first = cell.replays.find((replay) => replay.file !== null);
    if (!first) return "";
    const place = { scenario: cell.scenario, seed: first.seed, agent: cell.agent, robot: first.robot };
    return element("a", { href: link("replay", place) }, "watch");
  }

  function filters(redraw) {
    const { scenarios, agents } = crowdbench.index;
    const families = [...new Set(scenarios.map((scenario) => scenario.family))];
    const option = (value, text) =>
      element("option", { value, selected: value === chosen.family }, text);
    const family = element("select", { id: "family", change: () => {
      chosen.family = family.value;
      redraw();
    } }, option("", "all scenarios"), families.map((name) => option(name, name)));
    const box = (text, checked, change) => {
      const input = element("input", { type: "checkbox", checked, change: () => change(input.checked) });
      return element("label", {}, input, " ", text);
    };
    return element("form", { class: "filters", submit: (event) => event.preventDefault() },
      element("label", {}, "Family ", family),
      element("details", { id: "agents" }, element("summary", {}, "Agents"),
        agents.map(({ name }) => box(name, !chosen.hidden.has(name), (checked) => {
          chosen.hidden[checked ? "delete" : "add"](name);
          redraw();
        }))),
      box("All metrics", chosen.all, (checked) => {
        chosen.all = checked;
        redraw();
      }));
  }

  crowdbench.leaderboardView = function (page) {
    const boards = element("div", { id: "boards" });
    const redraw = (focus) => {
      const scenarios = crowdbench.index.scenarios.filter((scenario) =>
        !chosen.family || scenario.family === chosen.family);
      const held = document.activeElement && document.activeElement.closest("[data-scenario]");
      boards.replaceChildren(...scenarios.map((scenario) => {
        const cells = crowdbench.index.cells.filter((cell) =>
          cell.scenario === scenario.label && !chosen.hidden.has(cell.agent));
        return cells.length ? table(scenario, cells, redraw) : "";
      }));
      if (!boards.querySelector("table")) boards.append(element("p", {}, "Nothing is left to show."));
      if (focus && held) { // the button that was pressed has been replaced
        const board = [...boards.children].find((b) => b.dataset.scenario === held.dataset.scenario);
        board.querySelector(`[data-sort="${focus}"] button`).focus();
      }
    };
    page.append(
      element("h1", {}, "Leaderboard"),
      element("p", { class: "lead" },
        "Mean and 95 % interval over the stored episodes (Wilson for shares of episodes, else BCa bootstrap); ",
        "arrows point where better is. Press a heading to sort."),
      filters(redraw), boards);
    redraw();
  };
})(window.crowdbench);
