"use strict";
// Which view is shown: the part of the address after # says it.
(function (crowdbench) {
  const { element, link, place, index } = crowdbench;
  const page = document.getElementById("page");
  const whole = index.metrics.length > 0; // else the page holds replays alone

  const views = new Map([
    ["", crowdbench.leaderboardView],
    ["agents", crowdbench.agentsView],
    ["agent", crowdbench.agentView],
    ["tables", crowdbench.studyView],
    ["replay", crowdbench.replayView],
  ]);
  const entries = [
    ["", "Leaderboard", whole],
    ["replay", "Replays", crowdbench.watchable().length > 0],
    ["tables", "Tables and figures", index.tables.length + index.figures.length > 0],
    ["agents", "Agents", whole],
  ];

  let leave = () => {};

  function show() {
    const { view, parameters } = place(location.hash || index.start);
    const wanted = views.has(view) ? view : "";
    const chosen = wanted === "" && !whole ? "replay" : wanted;
    leave();
    page.replaceChildren();
    page.className = "view-" + (chosen || "leaderboard");
    document.getElementById("navigation").replaceChildren(
      ...entries.filter(([, , there]) => there).map(([name, text]) =>
        element("a", {
          href: link(name),
          "aria-current": name === chosen || (name === "agents" && chosen === "agent") ? "page" : null,
        }, text)),
    );
    leave = views.get(chosen)(page, parameters) || (() => {});
  }

  window.addEventListener("hashchange", show);
  document.querySelector(".brand").after(
    element("span", { class: "version" }, "version " + index.version));
  show();
})(window.crowdbench);
