"use strict";

/** Write a text into an element, unless it is there already. */
function say(id, text) {
  const element = byId(id);
  if (element && element.textContent !== text) element.textContent = text;
}

/** Say where a cell is, as tables of the commands do. */
function cellWords(film, cell) {
  return `row ${Math.floor(cell / film.cols)}, column ${cell % film.cols}`;
}

/** Write the numbers at a time. */
function showCounts(film, now) {
  const time = Math.floor(now);
  const step = Math.ceil(now) - 1;
  say("clock", `${time} / ${film.steps}`);
  if (film.headings.length) return showEpisode(film, time);
  const waiting = step < 0 ? 0 : film.waitsBy[step + 1] - film.waitsBy[step];
  say("count-step", `${time}`);
  say("count-tasks", film.finishedBy[time].toLocaleString("en"));
  say("count-throughput", time ? (film.finishedBy[time] / time).toFixed(3) : "-");
  say("count-waiting", `${waiting} (${Math.round(100 * (waiting / film.agents))}%)`);
}

/** Write the numbers of a walk through a maze. */
function showEpisode(film, time) {
  const seen = new Set(film.position.subarray(0, time + 1));
  say("count-step", `${time}`);
  say("count-shortest", `${facts.shortest} moves`);
  say("count-cells", `${seen.size}`);
  const over = time === film.steps;
  say("count-goal", film.finishedBy[time] ? "reached" : over ? "not reached" : "not yet");
}

/** Say what the followed robot does, and where it goes. */
function showFollowed(film, agent, now) {
  if (film.headings.length) return;
  byId("nobody").disabled = agent === null;
  if (agent === null) return say("doing", "No robot is followed: click a robot, or give its number.");
  const time = Math.floor(now);
  const step = Math.ceil(now) - 1;
  const goal = film.goal[time * film.agents + agent];
  const doing = doingOf(film, agent, step);
  const waited = step < 0 ? 0 : film.waited[step * film.agents + agent];
  const words = {
    driving: "driving",
    serving: "being served",
    idle: "without an order",
    waiting: `waiting for ${waited}${waited < WAITED_MOST ? "" : " or more"} timestep${waited === 1 ? "" : "s"}`,
  };
  const [tasks, since] = [tasksBy(film, agent, time), time - setOutAt(film, agent, time)];
  const served = doing === "serving" ? "" : `, on the way for ${since}`;
  const way = goal === film.idle ? "" : `; its goal: ${cellWords(film, goal)}${served}`;
  say("doing", `Robot ${agent}, ${words[doing]}, at ` +
    `${cellWords(film, film.position[time * film.agents + agent])}${way}. ` +
    `${tasks} task${tasks === 1 ? "" : "s"} finished.`);
}

/** Draw the pictures of the legend. */
function drawLegend() {
  for (const canvas of document.querySelectorAll("#legend canvas")) {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.height = 16 * ratio;
    if (canvas.dataset.kind === "ramp") continue;
    const context = canvas.getContext("2d");
    if (canvas.dataset.kind === "goal" && facts.shortest) {
      context.fillStyle = COLOURS.reached;
      context.fillRect(0, 0, canvas.width, canvas.height);
    } else MARKS[canvas.dataset.kind](context, 8 * ratio, 8 * ratio, 16 * ratio);
  }
}

/** Show the colours of what is laid over the floor, if anything is. */
function showRamp(kind) {
  byId("ramp").hidden = !kind;
  if (!kind) return;
  const canvas = document.querySelector('[data-kind="ramp"]');
  const context = canvas.getContext("2d");
  const shade = context.createLinearGradient(0, 0, canvas.width, 0);
  shade.addColorStop(0, "#fff");
  shade.addColorStop(1, `rgb(${RAMPS[kind]})`);
  context.fillStyle = shade;
  context.fillRect(0, 0, canvas.width, canvas.height);
}
