"use strict";
// The replay viewer: choosing an episode, playing it, and the address that says where one is.
(function (crowdbench) {
  const { element, fixed, icon, link, seconds, outcome } = crowdbench;
  const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
  const ICONS = {
    first: "M3 3h2v10H3zM13 3v10L6 8z", back: "M10 3h2v10h-2zM9 3v10L2 8z",
    play: "M4 2.5v11l9-5.5z", pause: "M4 3h3v10H4zM9 3h3v10H9z",
    on: "M4 3h2v10H4zM7 3v10l7-5z",
  };
  const LAYERS = [
    ["lidar", "LiDAR", true], ["trails", "Trails", true],
    ["goals", "Goals", true], ["intents", "Hidden intents", false],
  ];
  // Kept from one episode to the next.
  const shown = Object.fromEntries(LAYERS.map(([name, , on]) => [name, on]));
  let speed = 1;

  crowdbench.replayView = function (page, parameters) {
    const cells = crowdbench.watchable();
    page.append(element("h1", { class: "quiet" }, "Replay"));
    if (!cells.length) {
      page.append(element("p", {}, "No commands of episodes are stored; crowdbench run keeps them."));
      return undefined;
    }
    const wanted = chosen(cells, parameters);
    if (typeof wanted === "string") {
      page.append(element("p", { class: "problem", role: "alert" }, wanted));
      return undefined;
    }
    const viewer = new Viewer(page, cells, wanted);
    crowdbench.viewer = viewer;
    return () => {
      viewer.close();
      crowdbench.viewer = null;
    };
  };

  // What an address asks for; where it is silent, the first there is. A message if there is none.
  function chosen(cells, parameters) {
    const scenario = parameters.get("scenario") ?? cells[0].scenario;
    const here = cells.filter((cell) => cell.scenario === scenario);
    if (!here.length) return `No replays of scenario ${scenario} are in this page.`;
    const agent = parameters.get("agent") ?? here[0].agent;
    const cell = here.find((one) => one.agent === agent);
    if (!cell) return `No replays of agent ${agent} in ${scenario} are in this page.`;
    const first = cell.replays.find((replay) => replay.file !== null);
    const seed = parameters.has("seed") ? Number(parameters.get("seed")) : first.seed;
    const robot = parameters.get("robot") ?? cell.replays.find((r) => r.seed === seed)?.robot;
    if (!crowdbench.findReplay(scenario, agent, seed, robot)) {
      return `No replay of agent ${agent} in ${scenario} with seed ${parameters.get("seed")} is in this page.`;
    }
    const other = parameters.get("with");
    const beside = other && crowdbench.findReplay(scenario, other, seed, robot) ? other : null;
    const time = Number(parameters.get("t"));
    return { scenario, agent, seed, robot, with: beside, t: Number.isFinite(time) ? time : 0 };
  }

  class Viewer {
    constructor(page, cells, place) {
      this.place = place;
      this.cells = cells;
      this.scenes = [];
      this.time = 0;
      this.length = 0;
      this.playing = null;
      this.closed = false;
      this.panels = element("div", { class: "panels" });
      this.build(page);
      this.resized = new ResizeObserver(() => this.draw());
      this.resized.observe(this.panels);
      this.scheme = matchMedia("(prefers-color-scheme: dark)");
      this.redraw = () => this.draw();
      this.scheme.addEventListener("change", this.redraw);
      this.keys = (event) => this.key(event);
      document.addEventListener("keydown", this.keys);
      this.ready = this.load();
    }

    close() {
      this.closed = true;
      this.pause(false);
      this.resized.disconnect();
      this.scheme.removeEventListener("change", this.redraw);
      document.removeEventListener("keydown", this.keys);
    }

    // For tests: what was drawn last, one entry per episode.
    positions() {
      return this.scenes.map(({ episode, frame }) => ({
        agent: episode.agent, seed: episode.seed, state: frame.state, time: frame.time,
        robot: frame.robot, people: frame.people.map((person) => person.position),
      }));
    }

    build(page) {
      const button = (name, label, press) => element("button",
        { type: "button", title: label, "aria-label": label, click: press }, icon(ICONS[name]));
      this.button = button("play", "Play", () => this.toggle());
      this.button.id = "play";
      this.scrubber = element("input", { id: "scrub", type: "range", min: 0, max: 0, value: 0,
        "aria-label": "Time", input: () => {
          this.pause(false);
          this.go(Number(this.scrubber.value));
        }, change: () => this.remember() });
      this.clock = element("output", { class: "clock" });
      this.tracks = element("div", { class: "tracks" });
      this.lists = element("div", { class: "lists" });
      this.permanent = element("a", { id: "link" }, "Link to this moment");
      const rate = element("select", { "aria-label": "Speed", id: "speed", change: () => {
        speed = Number(rate.value);
      } }, SPEEDS.map((value) => element("option", { value, selected: value === speed }, `${value} ×`)));
      const layers = LAYERS.map(([name, text]) => {
        const input = element("input", { type: "checkbox", id: "show-" + name, checked: shown[name],
          change: () => {
            shown[name] = input.checked;
            this.hide();
            this.draw();
          } });
        return element("label", {}, input, " ", text);
      });
      page.append(this.selectors(), this.panels,
        element("div", { class: "transport" }, element("div", { class: "controls" },
          button("first", "To the beginning", () => this.jump(0)),
          button("back", "A step back", () => this.step(-1)), this.button,
          button("on", "A step on", () => this.step(1)), rate, this.clock),
        element("div", { class: "timeline" }, this.tracks, this.scrubber)),
        element("div", { class: "layers" }, layers),
        element("p", { class: "note" }, this.permanent,
          " · Space plays, arrow keys step. Discs see the robot, rings do not. ",
          "LiDAR is cast from the positions, without noise. On the time line: ▲ cut-off, bar: time ",
          "to collision below 1 s, ✕ collision, ★ arrival, ◆ hidden switch."),
        this.lists);
    }

    selectors() {
      const { place, cells } = this;
      const unique = (values) => [...new Set(values)];
      const select = (label, key, options, value) => {
        const box = element("select", { id: "choose-" + key, change: () => {
          const changed = { ...this.place, t: null, [key]: box.value || null };
          location.hash = link("replay", fitting(this.cells, changed, key));
        } }, options.map(([option, text]) =>
          element("option", { value: option, selected: option === String(value ?? "") }, text)));
        return element("label", {}, label, " ", box);
      };
      const plain = (values) => values.map((value) => [String(value), String(value)]);
      const here = cells.filter((cell) => cell.scenario === place.scenario);
      const cell = here.find((one) => one.agent === place.agent);
      const rivals = here.filter((one) => one.agent !== place.agent &&
        one.replays.some((r) => r.seed === place.seed && r.robot === place.robot));
      const robots = unique(cell.replays.map((replay) => replay.robot));
      return element("form", { class: "filters", submit: (event) => event.preventDefault() },
        select("Scenario", "scenario", plain(unique(cells.map((c) => c.scenario))), place.scenario),
        select("Agent", "agent", plain(here.map((one) => one.agent)), place.agent),
        select("Seed", "seed", plain(unique(cell.replays.map((r) => r.seed))), place.seed),
        robots.length > 1 ? select("Robot", "robot", plain(robots), place.robot) : null,
        select("Beside", "with", [["", "nobody"], ...plain(rivals.map((one) => one.agent))], place.with));
    }

    async load() {
      const { place } = this;
      const names = [place.agent, ...(place.with ? [place.with] : [])];
      const found = names.map((agent) =>
        crowdbench.findReplay(place.scenario, agent, place.seed, place.robot));
      try {
        const episodes = await Promise.all(
          found.map(({ cell, replay }) => crowdbench.loadEpisode(cell, replay)));
        if (!this.closed) this.open(episodes);
      } catch (error) {
        this.panels.replaceChildren(element("p", { class: "problem", role: "alert" }, error.message));
      }
    }

    open(episodes) {
      const scenario = crowdbench.scenario(this.place.scenario);
      const go = (time) => this.jump(time);
      this.length = Math.max(...episodes.map((episode) => episode.duration));
      this.period = episodes[0].period;
      this.scrubber.max = this.length;
      this.scrubber.step = this.period;
      this.scenes = episodes.map((episode) => {
        const canvas = element("canvas", { role: "img",
          "aria-label": `Seed ${episode.seed} of ${episode.scenario}, driven by ${episode.agent}` });
        const { sign, label } = outcome(episode.outcome);
        const status = element("span", { class: "status" });
        this.panels.append(element("figure", { class: "panel" },
          element("figcaption", {}, element("strong", {}, episode.agent), " ",
            element("span", { class: "end-" + episode.outcome },
              `${sign} ${label} after ${seconds(episode.duration)}`), " ", status), canvas));
        const scene = new crowdbench.Scene(canvas, episode, scenario);
        scene.status = status;
        return scene;
      });
      this.panels.classList.toggle("two", episodes.length > 1);
      const [wide, high] = this.scenes[0].half;
      this.panels.style.setProperty("--aspect", wide / high);
      this.tracks.replaceChildren(...episodes.map((episode) =>
        crowdbench.track(episode.agent, episode, this.length, go)));
      this.lists.replaceChildren(...episodes.map((episode) =>
        crowdbench.eventList(episode.agent, episode, go)));
      if (!this.scenes[0].lidar) document.getElementById("show-lidar").disabled = true;
      this.hide();
      this.go(this.place.t ?? 0);
      this.remember();
    }

    // Switches are hidden knowledge: their marks show only with the intents.
    hide() {
      for (const box of [this.tracks, this.lists]) box.classList.toggle("hide-intents", !shown.intents);
    }

    draw() {
      for (const scene of this.scenes) {
        scene.draw(this.time, shown);
        const [v, w] = scene.frame.motion;
        scene.status.textContent = `v ${fixed(v)} m/s, w ${fixed(w)} rad/s`;
      }
    }

    // Show a time [s], within the episode.
    go(time) {
      this.time = Math.min(Math.max(time, 0), this.length);
      this.scrubber.value = this.time;
      this.clock.textContent = `${seconds(this.time)} of ${seconds(this.length)}`;
      this.permanent.href = this.address();
      this.draw();
    }

    jump(time) {
      this.pause(false);
      this.go(time);
      this.remember();
    }

    step(count) {
      this.jump((Math.round(this.time / this.period) + count) * this.period);
    }

    address() {
      return link("replay", { ...this.place, t: Number(this.time.toFixed(3)) });
    }

    // Let the address say where one is, without a new entry in the history.
    remember() {
      this.place.t = this.time;
      history.replaceState(null, "", this.address());
    }

    toggle() {
      if (this.playing !== null) this.pause();
      else this.play();
    }

    play() {
      if (!this.scenes.length) return;
      if (this.time >= this.length) this.time = 0;
      let last = performance.now();
      const advance = (now) => {
        this.go(this.time + (speed * Math.max(0, now - last)) / 1000);
        last = now;
        if (this.time >= this.length) this.pause();
        else this.playing = requestAnimationFrame(advance);
      };
      this.playing = requestAnimationFrame(advance);
      this.label("pause", "Pause");
    }

    pause(remember = true) {
      if (this.playing !== null) cancelAnimationFrame(this.playing);
      this.playing = null;
      this.label("play", "Play");
      if (remember) this.remember();
    }

    label(name, text) {
      this.button.replaceChildren(icon(ICONS[name]));
      this.button.title = text;
      this.button.setAttribute("aria-label", text);
    }

    key(event) {
      if (event.target.closest("select, input, button, a, summary")) return;
      const steps = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (steps) this.step(steps);
      else if (event.key === " ") this.toggle();
      else return;
      event.preventDefault();
    }
  }

  // After one choice has changed, keep of the others what exists with it.
  function fitting(cells, place, changed) {
    const here = cells.filter((cell) => cell.scenario === place.scenario);
    const cell = here.find((one) => one.agent === place.agent) || here[0];
    const seed = Number(place.seed);
    const fits = cell.replays.filter((r) => r.seed === seed && r.file !== null);
    const replay = fits.find((r) => r.robot === place.robot) || fits[0] ||
      cell.replays.find((r) => r.file !== null);
    const beside = changed === "agent" && place.with === cell.agent ? null : place.with;
    return { scenario: cell.scenario, agent: cell.agent, seed: replay.seed, robot: replay.robot,
      with: beside };
  }
})(window.crowdbench);
