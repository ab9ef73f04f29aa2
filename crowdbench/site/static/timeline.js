"use strict";
// The time line: what happened when, as marks to press and as a list to read.
(function (crowdbench) {
  const { element, seconds, outcome } = crowdbench;
  const KINDS = {
    cutoff: { sign: "▲", text: "cut-off" },
    ttc: { sign: "", text: "time to collision below 1 s" },
    switch: { sign: "◆", text: "hidden switch" },
  };

  function describe(event) {
    const person = event.pedestrian === null ? "" : `person ${event.pedestrian}`;
    if (event.kind === "cutoff") return `cut-off: ${person}, gap ${seconds(event.value)}`;
    if (event.kind === "ttc") {
      return `time to collision below 1 s: ${person}, down to ${event.value.toFixed(2)} s`;
    }
    if (event.kind === "switch") {
      return `hidden switch: ${person} ${event.detail === "return" ? "turns back" : "takes a new goal"}`;
    }
    const { label } = outcome(event.kind);
    if (event.kind === "collision") return `collision with ${person || "a " + event.detail}`;
    return event.detail ? `${label}: ${event.detail}` : label;
  }

  // Marks of one episode on a track of some seconds; pressing one goes to its beginning.
  crowdbench.track = function (name, episode, length, go) {
    const track = element("div", { class: "track", "aria-label": "Events of " + name });
    const span = Math.max(length, episode.period);
    const place = (mark, share, property) =>
      mark.style.setProperty(property, `${(100 * share).toFixed(3)}%`);
    const line = element("span", { class: "extent" });
    place(line, episode.duration / span, "width");
    track.append(line);
    for (const event of episode.events) {
      const at = event.first * episode.period;
      const told = `${seconds(at)} ${describe(event)}`;
      const sign = KINDS[event.kind] ? KINDS[event.kind].sign : outcome(event.kind).sign;
      const mark = element("button", { type: "button", class: "mark mark-" + event.kind,
        title: told, "aria-label": told, "data-time": at, click: () => go(at) }, sign);
      place(mark, at / span, "left");
      if (event.kind === "ttc") {
        place(mark, ((event.last - event.first) * episode.period) / span, "width");
      }
      track.append(mark);
    }
    return track;
  };

  crowdbench.eventList = function (name, episode, go) {
    return element("div", {}, element("h3", {}, name),
      element("ol", { class: "events" }, episode.events.map((event) => {
        const at = event.first * episode.period;
        return element("li", { class: "event-" + event.kind },
          element("button", { type: "button", click: () => go(at) }, seconds(at)), " ", describe(event));
      })));
  };
})(window.crowdbench);
