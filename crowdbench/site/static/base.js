"use strict";
// What every part of the page uses: elements, addresses and numbers.
// All parts share one object; files opened from the disk cannot be JavaScript modules.
window.crowdbench = {};

(function (crowdbench) {
  // An element with attributes and children. Text becomes text, whatever it contains: names and
  // messages come from outside and never become markup.
  crowdbench.element = function (tag, attributes, ...children) {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes || {})) {
      if (typeof value === "function") element.addEventListener(name, value);
      else if (value === true) element.setAttribute(name, "");
      else if (value !== false && value != null) element.setAttribute(name, value);
    }
    element.append(...children.flat().filter((child) => child != null));
    return element;
  };

  // A name that may be broken where its parts meet.
  crowdbench.name = (text) =>
    text.split(/(?<=[_:,@])/).flatMap((part, i) => (i ? [document.createElement("wbr"), part] : part));

  // A picture on a button, 16 x 16; fonts do not have these signs everywhere.
  crowdbench.icon = function (path) {
    const [svg, shape] = ["svg", "path"].map((tag) =>
      document.createElementNS("http://www.w3.org/2000/svg", tag));
    svg.setAttribute("viewBox", "0 0 16 16");
    svg.setAttribute("aria-hidden", "true");
    shape.setAttribute("d", path);
    svg.append(shape);
    return svg;
  };

  // The address of a view, e.g. link("replay", {seed: 3}) is "#/replay?seed=3".
  crowdbench.link = function (view, parameters) {
    const given = Object.entries(parameters || {}).filter(([, value]) => value != null);
    const query = new URLSearchParams(given.map(([key, value]) => [key, String(value)]));
    return "#/" + view + (given.length ? "?" + query : "");
  };

  // The inverse of link: {view, parameters}, parameters as a Map.
  crowdbench.place = function (hash) {
    const [view, query] = hash.replace(/^#\/?/, "").split(/\?(.*)/s);
    return { view, parameters: new Map(new URLSearchParams(query || "")) };
  };

  // The decimals that give a value two significant digits.
  crowdbench.twoSignificant = (value) =>
    Math.abs(value) < 1e-12 ? 0 : Math.max(0, 1 - Math.floor(Math.log10(Math.abs(value))));

  // A number of decimals, without a sign in front of zero.
  crowdbench.fixed = (value, digits = 2) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1");
  crowdbench.seconds = (value) => value.toFixed(1) + " s";

  crowdbench.OUTCOMES = {
    success: { label: "success", sign: "★" },
    collision: { label: "collision", sign: "✕" },
    timeout: { label: "timeout", sign: "◷" },
    agent_error: { label: "agent error", sign: "!" },
  };
  crowdbench.outcome = (name) => crowdbench.OUTCOMES[name] || { label: name, sign: "?" };
})(window.crowdbench);
