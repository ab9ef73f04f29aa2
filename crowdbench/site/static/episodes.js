"use strict";
// The stored episodes: which there are, and loading them a file at a time.
(function (crowdbench) {
  const files = new Map(); // name -> promise of its episodes
  const waiting = new Map(); // name -> resolve

  // Called by the data files.
  crowdbench.receive = (name, episodes) => waiting.get(name)(episodes);

  crowdbench.scenario = (label) =>
    crowdbench.index.scenarios.find((scenario) => scenario.label === label);

  // Cells (an agent in a scenario) with something to watch.
  crowdbench.watchable = () =>
    crowdbench.index.cells.filter((cell) => cell.replays.some((replay) => replay.file !== null));

  crowdbench.findReplay = function (scenario, agent, seed, robot) {
    const cell = crowdbench.index.cells.find((c) => c.scenario === scenario && c.agent === agent);
    const replay = cell && cell.replays.find((r) => r.seed === seed && r.robot === robot);
    return replay && { cell, replay };
  };

  // Promise of a decoded episode; every file is loaded once.
  crowdbench.loadEpisode = async function (cell, replay) {
    if (replay.file === null) throw new Error("This episode is too long for the report page.");
    const name = cell.files[replay.file];
    if (!files.has(name)) files.set(name, loadFile(name));
    const found = (await files.get(name)).find(
      (episode) => episode.seed === replay.seed && episode.robot === replay.robot,
    );
    return decode(found, cell);
  };

  function loadFile(name) {
    return new Promise((resolve, reject) => {
      waiting.set(name, resolve);
      const address = name.split("/").map(encodeURIComponent).join("/");
      const script = crowdbench.element("script", { src: address });
      script.onload = () => script.remove();
      script.onerror = () => {
        files.delete(name);
        reject(new Error("The file " + name + " is missing beside this page."));
      };
      document.head.append(script);
    });
  }

  function floats(text) {
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }

  function decode(stored, cell) {
    const episode = { ...stored, scenario: cell.scenario, agent: cell.agent };
    for (const name of ["pose", "motion", "others", "position", "velocity"]) {
      episode[name] = floats(stored[name]);
    }
    episode.duration = stored.steps * stored.period;
    episode.otherCount = episode.others.length / 3 / (stored.steps + 1);
    return episode;
  }

  // The entry of a list of [state, ...] changes that holds at a state.
  function holding(changes, state) {
    let low = 0;
    let high = changes.length - 1;
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (changes[middle][0] <= state) low = middle;
      else high = middle - 1;
    }
    return changes[low];
  }

  // Whether a person has entered the scene anew at a state: it has not walked there.
  crowdbench.enters = function (episode, p, state) {
    const index = 2 * (state * episode.people + p);
    const before = index - 2 * episode.people;
    const [positions, velocity] = [episode.position, episode.velocity];
    const moved = Math.hypot(
      positions[index] - positions[before], positions[index + 1] - positions[before + 1]);
    const walked = episode.period * Math.hypot(velocity[index], velocity[index + 1]);
    return moved > walked + 0.5;
  };

  // Where everybody is at a time [s]: exactly as logged at the states, between them on straight
  // lines. What is not a place (goals, intents) is as in the state before.
  crowdbench.frame = function (episode, time) {
    const place = Math.min(Math.max(time / episode.period, 0), episode.steps);
    const near = Math.round(place);
    const state = Math.abs(place - near) < 1e-6 ? near : Math.floor(place);
    const share = state === near && Math.abs(place - near) < 1e-6 ? 0 : place - state;
    const mix = (array, index, width, walks = true) =>
      share && walks ? (1 - share) * array[index] + share * array[index + width] : array[index];

    const poseAt = (array, count, robot) => {
      const index = 3 * (state * count + robot);
      const [x, y] = [mix(array, index, 3 * count), mix(array, index + 1, 3 * count)];
      const turn = share ? array[index + 3 * count + 2] - array[index + 2] : 0;
      return [x, y, array[index + 2] + share * Math.atan2(Math.sin(turn), Math.cos(turn))];
    };
    const people = [];
    for (let p = 0; p < episode.people; p++) {
      const index = 2 * (state * episode.people + p);
      const width = 2 * episode.people;
      const [, intent, switchTime] = holding(episode.legs[p], state);
      const walks = !share || !crowdbench.enters(episode, p, state + 1);
      people.push({
        position: [0, 1].map((axis) => mix(episode.position, index + axis, width, walks)),
        velocity: [0, 1].map((axis) => mix(episode.velocity, index + axis, width, walks)),
        goal: holding(episode.goals[p], state).slice(1),
        intent: episode.intents[intent],
        switchTime,
        sees: Boolean(holding(episode.sees[p], state)[1]),
        radius: episode.radii[p],
      });
    }
    const others = [];
    for (let r = 0; r < episode.otherCount; r++) {
      const pose = poseAt(episode.others, episode.otherCount, r);
      if (pose.every(Number.isFinite)) others.push(pose);
    }
    const step = Math.min(state, episode.steps - 1);
    return {
      time: (state + share) * episode.period,
      state,
      robot: poseAt(episode.pose, 1, 0),
      motion: step < 0 ? [0, 0] : Array.from(episode.motion.slice(2 * step, 2 * step + 2)),
      others,
      people,
    };
  };

  // Recorded people come and go; those who are not there have no position.
  crowdbench.isThere = (person) => Number.isFinite(person.position[0]);
})(window.crowdbench);
