"use strict";

const LONGEST = 0.1; // seconds of playing that one frame may skip, after a pause of the browser
const NEAR = 0.8; // cells around a click in which a robot is meant
const ZOOM = 1.5;

// What the page shows; `now` is a timestep, or lies between two. `stats` counts the frames drawn so
// far, and the milliseconds of drawing them.
const state = {
  film: null, view: null, ground: null, sprites: {}, now: 0, playing: false, last: 0,
  followed: null, stats: {frames: 0, drawing: 0},
};

/** Draw everything as it is now. */
function draw() {
  const begin = performance.now();
  const {film, view, ground, sprites, now, followed} = state;
  drawGround(byId("ground"), film, ground, view, byId("overlay").value, Math.floor(now));
  const canvas = byId("robots");
  const context = canvas.getContext("2d");
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (film.headings.length) drawAgent(context, film, view, sprites, now);
  else {
    if (byId("jams").checked) drawJams(context, film, view, sprites, now);
    if (byId("goals").checked) drawGoals(context, film, view, sprites, now);
    if (followed !== null) drawWay(context, film, view, followed, now);
    drawRobots(context, film, view, sprites, now);
    if (followed !== null) drawFollowed(context, film, view, followed, now);
  }
  showCounts(film, now);
  showFollowed(film, followed, now);
  byId("scrub").value = Math.floor(now);
  for (const chart of document.querySelectorAll(".chart")) moveCursor(chart, now);
  state.stats.frames++;
  state.stats.drawing += performance.now() - begin;
}

/** Keep the followed robot in sight, and draw. */
function look() {
  const {film, view, now, followed} = state;
  if (followed !== null) keepInView(view, ...placeOf(film, followed, now));
  draw();
}

/** Go to a time. */
function goTo(time) {
  state.now = Math.min(Math.max(time, 0), state.film.steps);
  look();
}

/** Go a timestep on or back, to a whole one, and rest there. */
function step(by) {
  play(false);
  goTo(by > 0 ? Math.floor(state.now) + 1 : Math.ceil(state.now) - 1);
}

/** Begin or stop to play. */
function play(playing) {
  if (playing && state.now >= state.film.steps) state.now = 0;
  if (playing && !state.playing) {
    state.last = performance.now();
    requestAnimationFrame(tick);
  }
  state.playing = playing;
  byId("play").textContent = playing ? "Pause" : "Play";
}

/** Play on for as long as passed since the last frame. */
function tick(time) {
  if (!state.playing) return;
  const passed = Math.min(Math.max(time - state.last, 0) / 1000, LONGEST);
  state.last = time;
  state.now = Math.min(state.now + passed * Number(byId("speed").value), state.film.steps);
  if (state.now === state.film.steps) play(false);
  look();
  if (state.playing) requestAnimationFrame(tick);
}

/** Choose the next faster or slower speed. */
function changeSpeed(by) {
  const speed = byId("speed");
  speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), speed.length - 1);
}

/** Follow a robot, or nobody (null). */
function follow(agent) {
  state.followed = agent;
  byId("robot").value = agent ?? "";
  look();
}

/** Find the robot at a point of the stage; null where none is near. */
function robotAt(x, y) {
  const {film, view, now} = state;
  const [column, row] = [(x - view.x) / view.scale, (y - view.y) / view.scale];
  let [best, nearest] = [null, Math.max(NEAR, 9 / view.scale)];
  for (let agent = 0; agent < film.agents; agent++) {
    const [right, down] = placeOf(film, agent, now);
    const distance = Math.hypot(right - column, down - row);
    if (distance < nearest) [best, nearest] = [agent, distance];
  }
  return best;
}

/** Zoom and draw. */
function zoom(factor, x, y) {
  zoomView(state.view, factor, x, y);
  draw();
}

/** Show the whole layout and draw. */
function fit() {
  fitView(state.view);
  draw();
}

// What keys do, wherever the page has the focus.
const KEYS = {
  " ": () => play(!state.playing),
  ArrowLeft: () => step(-1),
  ArrowRight: () => step(1),
  ArrowUp: () => changeSpeed(1),
  ArrowDown: () => changeSpeed(-1),
  "+": () => zoom(ZOOM),
  "=": () => zoom(ZOOM),
  "-": () => zoom(1 / ZOOM),
  0: fit,
  Home: () => goTo(0),
  End: () => goTo(state.film.steps),
};

/** Do what a key says, unless it is meant for what has the focus. */
function pressed(event) {
  const own = event.target.closest("input:not([type=checkbox]), select");
  const presses = event.key === " " && event.target.closest("button, input");
  if ((own && event.key !== " ") || presses || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = KEYS[event.key];
  if (!action) return;
  event.preventDefault();
  action();
}
