"use strict";
// What is read rather than watched: agents with their cards, tables, figures.
(function (crowdbench) {
  const { element, link, outcome } = crowdbench;
  const SHOWN_AT_ONCE = 60;

  // HTML made by crowdbench from Markdown, in which no HTML of the author's survives.
  function prepared(html, name) {
    const box = element("div", { class: name });
    box.innerHTML = html;
    for (const table of box.querySelectorAll("table")) {
      const scroll = element("div", { class: "scroll", tabindex: "0" });
      table.replaceWith(scroll);
      scroll.append(table);
    }
    for (const anchor of box.querySelectorAll("a")) anchor.rel = "noreferrer";
    return box;
  }

  crowdbench.agentsView = function (page) {
    page.append(element("h1", {}, "Agents"),
      element("ul", { class: "agents" }, crowdbench.index.agents.map((agent) =>
        element("li", {}, element("a", { href: link("agent", { name: agent.name }) }, agent.name),
          agent.summary ? " " + agent.summary : ""))));
  };

  crowdbench.agentView = function (page, parameters) {
    const name = parameters.get("name");
    const agent = crowdbench.index.agents.find((one) => one.name === name);
    if (!agent) {
      page.append(element("h1", {}, "No such agent"), element("p", {}, `${name} is not in these results.`));
      return;
    }
    const cells = crowdbench.index.cells.filter((cell) => cell.agent === name);
    page.append(element("h1", {}, name),
      agent.summary ? element("p", { class: "lead" }, agent.summary) : "",
      results(cells), facts(cells),
      element("h2", {}, "Model card"),
      agent.card ? prepared(agent.card, "card")
        : element("p", { class: "note" }, "This agent's package has no README.md."),
      element("h2", {}, "Replays"), ...cells.map(replays));
  };

  function results(cells) {
    const metrics = crowdbench.shownMetrics();
    return element("div", { class: "scroll", tabindex: "0" }, element("table", {},
      element("thead", {}, element("tr", {}, element("th", { scope: "col" }, "scenario"),
        metrics.map((metric) => element("th",
          { scope: "col", class: "number", title: metric.definition }, crowdbench.metricHead(metric))),
        element("th", { scope: "col" }, "ended by"))),
      element("tbody", {}, cells.map((cell) => element("tr", {},
        element("th", { scope: "row" }, crowdbench.name(cell.scenario)),
        metrics.map((metric) => crowdbench.cellValue(cell, metric)),
        element("td", { class: "ends" }, cell.outcomes.map(([end, count]) =>
          `${count} ${outcome(end).label}`).join(", ")))))));
  }

  function facts(cells) {
    const all = (key) => [...new Set(cells.flatMap((cell) => cell[key]))].filter(Boolean).join("; ");
    const errors = cells.flatMap((cell) => cell.errors.map(([seed, text]) =>
      element("li", {}, `${cell.scenario}, seed ${seed}: ${text}`)));
    const lines = [["Code", "code"], ["Weights (SHA-256)", "weights"],
      ["crowdbench", "version"], ["Machine", "machines"]];
    return element("div", {},
      element("dl", {}, lines.filter(([, key]) => all(key)).flatMap(([text, key]) =>
        [element("dt", {}, text), element("dd", {}, all(key))])),
      errors.length
        ? element("details", {}, element("summary", {}, "Errors"), element("ul", {}, errors)) : "");
  }

  function replays(cell) {
    const list = element("p", { class: "seeds" });
    const fill = () => list.childElementCount || list.append(...cell.replays.map((replay) => {
      const { label, sign } = outcome(replay.outcome);
      const place = { scenario: cell.scenario, seed: replay.seed, agent: cell.agent, robot: replay.robot };
      const told = `seed ${replay.seed}: ${label} after ${replay.seconds.toFixed(1)} s, ` +
        `${replay.cutoffs} cut-offs`;
      return element("a", { href: link("replay", place), class: "end-" + replay.outcome,
        title: told, "aria-label": told }, `${replay.seed} ${sign}`);
    }));
    const few = cell.replays.length <= SHOWN_AT_ONCE;
    const box = element("details", { toggle: fill, open: few },
      element("summary", {}, `${cell.scenario}: ${cell.replays.length || "no"} replays`), list);
    if (few) fill();
    return box;
  }

  crowdbench.studyView = function (page) {
    const { tables, figures } = crowdbench.index;
    page.append(element("h1", {}, "Tables and figures"),
      element("p", { class: "lead" }, "What the study compares, measured here."));
    if (!tables.length) {
      page.append(element("p", { class: "note" }, "None of the tables' episodes are stored yet."));
    }
    for (const table of tables) {
      page.append(element("h2", {}, table.title), prepared(table.html, "study-table"));
    }
    for (const figure of figures) {
      page.append(element("figure", {}, element("h2", {}, figure.title),
        element("img", { src: figure.png, alt: figure.title, loading: "lazy" }),
        element("figcaption", {}, figure.caption, " ", element("a", { href: figure.pdf }, "PDF"))));
    }
  };
})(window.crowdbench);
