"use strict";

const DIGITS = [25, 5, 1]; // three moves a byte
const WAITED_MOST = 255; // timesteps of waiting in a row, the most that are counted

/** Unpack an array of numbers by its name. */
async function numbers(name, kind) {
  return new kind(await unpack(name));
}

/**
 * Undo what `qdenv/view/replay.py` encoded.
 * Cells by timestep and robot, row-major: `position` and `goal` [(steps + 1) * agents]; `waited`
 * [steps * agents] is for how many timesteps a robot has waited in a row after each step, 0 where
 * it moved, was served or had no order: `idle` is its goal then. `finishedBy` and `waitsBy`
 * [steps + 1] are sums since the beginning; `turns` holds for each robot the timesteps at which it
 * got another goal, `tasks` those of them at which it finished a task.
 */
async function readFilm() {
  const {rows, cols, agents, steps} = facts;
  const cell = rows * cols < 65536 ? Uint16Array : Uint32Array;
  const [moves, starts] = [await numbers("moves", Uint8Array), await numbers("starts", Uint32Array)];
  const film = {
    rows, cols, agents, steps, starts,
    tiles: await numbers("tiles", Uint8Array),
    headings: await numbers("headings", Uint8Array),
    position: new cell((steps + 1) * agents),
    goal: new cell((steps + 1) * agents),
    waited: new Uint8Array(steps * agents),
    finishedBy: new Uint32Array(steps + 1),
    waitsBy: new Uint32Array(steps + 1),
    turns: [],
    tasks: [],
    idle: new cell([-1])[0],
  };
  await readGoals(film);
  readMoves(film, moves, [0, 1, -1, cols, -cols]);
  for (let time = 1; time <= steps; time++) {
    film.finishedBy[time] += film.finishedBy[time - 1];
    film.waitsBy[time] += film.waitsBy[time - 1];
  }
  return film;
}

/** Write down each robot's goal at every timestep, when it got it, and when it finished its tasks. */
async function readGoals(film) {
  const [first, counts] = [await numbers("goals", Uint32Array), await numbers("counts", Uint32Array)];
  const [times, next] = [await numbers("times", Uint32Array), await numbers("next", Uint32Array)];
  const done = byId("packed-done") ? await numbers("done", Uint8Array) : null;
  let event = 0;
  for (let agent = 0; agent < film.agents; agent++) {
    const [from, end] = [event, event + counts[agent]];
    film.turns.push(times.subarray(from, end));
    film.tasks.push(film.turns[agent].filter((_, index) => !done || done[from + index]));
    let goal = first[agent];
    for (let time = 0; time <= film.steps; time++) {
      for (; event < end && times[event] === time; event++) {
        goal = next[event];
        film.finishedBy[time] += done ? done[event] : 1;
      }
      film.goal[time * film.agents + agent] = goal;
    }
  }
}

/** Add up each robot's moves, and its waiting. */
function readMoves(film, moves, strides) {
  const {agents, steps, position, goal, waited} = film;
  const row = Math.ceil(steps / 3);
  for (let agent = 0; agent < agents; agent++) {
    let [cell, since] = [film.starts[agent], 0];
    position[agent] = cell;
    for (let time = 0; time < steps; time++) {
      const three = moves[agent * row + Math.floor(time / 3)];
      const move = Math.floor(three / DIGITS[time % 3]) % 5;
      const at = time * agents + agent;
      cell += strides[move];
      const waits = move === 0 && cell !== goal[at] && goal[at] !== film.idle;
      since = waits ? Math.min(since + 1, WAITED_MOST) : 0;
      waited[at] = since;
      position[at + agents] = cell;
      film.waitsBy[time + 1] += waits;
    }
  }
}

/** Say what a robot does in a step, which is -1 before the first. */
function doingOf(film, agent, step) {
  if (step < 0) return "driving";
  const at = step * film.agents + agent;
  if (film.position[at] !== film.position[at + film.agents]) return "driving";
  if (film.goal[at] === film.idle) return "idle";
  return film.waited[at] ? "waiting" : "serving";
}

/** Count the tasks that a robot has finished by a timestep. */
function tasksBy(film, agent, time) {
  return film.tasks[agent].filter((finished) => finished <= time).length;
}

/** Find since when a robot is on its way to its goal. */
function setOutAt(film, agent, time) {
  return film.turns[agent].findLast((turn) => turn <= time) ?? 0;
}
