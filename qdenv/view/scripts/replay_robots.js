"use strict";

const [JAM_FROM, JAM_STEP] = facts.jam; // timesteps of waiting in a row

/** Say where a robot is between two timesteps: column and row of its middle. */
function placeOf(film, agent, now) {
  const before = Math.floor(now);
  const after = Math.min(before + 1, film.steps);
  const [here, there] = [film.position[before * film.agents + agent],
    film.position[after * film.agents + agent]];
  const [row, next] = [Math.floor(here / film.cols), Math.floor(there / film.cols)];
  const column = here - row * film.cols;
  const share = now - before;
  return [column + (there - next * film.cols - column) * share + 0.5,
    row + (next - row) * share + 0.5];
}

/** Copy a mark to a place (column, row) of the canvas, unless it is out of sight. */
function stamp(context, picture, view, column, row) {
  const half = picture.width / 2;
  const [x, y] = pixelAt(view, column, row);
  const {width, height} = context.canvas;
  const seen = x > -half && y > -half && x < width + half && y < height + half;
  if (seen) context.drawImage(picture, x - half, y - half);
}

/** Draw who waits for long: a halo that grows warmer. */
function drawJams(context, film, view, sprites, now) {
  const step = Math.ceil(now) - 1;
  if (step < 0) return;
  for (let agent = 0; agent < film.agents; agent++) {
    const waited = film.waited[step * film.agents + agent];
    if (waited < JAM_FROM) continue;
    const level = Math.min(Math.floor((waited - JAM_FROM) / JAM_STEP), facts.warmth.length - 1);
    const picture = spriteOf(sprites, "jam", view.scale * view.ratio, level);
    stamp(context, picture, view, ...placeOf(film, agent, now));
  }
}

/** Draw the goals of all robots. */
function drawGoals(context, film, view, sprites, now) {
  const picture = spriteOf(sprites, "goal", view.scale * view.ratio);
  const time = Math.floor(now);
  for (let agent = 0; agent < film.agents; agent++) {
    const cell = film.goal[time * film.agents + agent];
    if (cell === film.idle) continue;
    stamp(context, picture, view, cell % film.cols + 0.5, Math.floor(cell / film.cols) + 0.5);
  }
}

/** Draw all robots. */
function drawRobots(context, film, view, sprites, now) {
  const step = Math.ceil(now) - 1;
  const size = view.scale * view.ratio;
  const pictures = {};
  for (const kind of ["driving", "waiting", "serving"]) pictures[kind] = spriteOf(sprites, kind, size);
  pictures.idle = pictures.serving;
  for (let agent = 0; agent < film.agents; agent++) {
    const picture = pictures[doingOf(film, agent, step)];
    stamp(context, picture, view, ...placeOf(film, agent, now));
  }
}

/** Draw the way of a robot since it set out, and the line to its goal. */
function drawWay(context, film, view, agent, now) {
  const time = Math.floor(now);
  const size = view.scale * view.ratio;
  context.beginPath();
  const since = film.headings.length ? 0 : setOutAt(film, agent, time);
  for (let past = since; past <= time; past++) {
    context.lineTo(...pixelAt(view, ...placeOf(film, agent, past)));
  }
  const place = pixelAt(view, ...placeOf(film, agent, now));
  context.lineTo(...place);
  context.lineWidth = Math.max(2, size / 6);
  context.lineJoin = "round";
  context.strokeStyle = `${COLOURS.way}c0`;
  context.stroke();
  const cell = film.goal[time * film.agents + agent];
  if (film.headings.length || cell === film.idle) return;
  const goal = pixelAt(view, cell % film.cols + 0.5, Math.floor(cell / film.cols) + 0.5);
  context.beginPath();
  context.moveTo(...place);
  context.lineTo(...goal);
  context.setLineDash([6 * view.ratio, 4 * view.ratio]);
  context.lineWidth = 1.5 * view.ratio;
  context.strokeStyle = COLOURS.ink;
  context.stroke();
  context.setLineDash([]);
  diamond(context, ...goal, Math.max(0.62 * size, 5 * view.ratio), 2 * view.ratio);
}

/** Draw a ring around the followed robot, and its number. */
function drawFollowed(context, film, view, agent, now) {
  const [x, y] = pixelAt(view, ...placeOf(film, agent, now));
  const radius = Math.max(0.52 * view.scale, 7) * view.ratio;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  for (const [colour, width] of [["#fff", 5], [COLOURS.ink, 2.5]]) {
    context.strokeStyle = colour;
    context.lineWidth = width * view.ratio;
    context.stroke();
  }
  context.font = `600 ${13 * view.ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  const [text, left] = [`${agent}`, x + radius + 5 * view.ratio];
  context.lineWidth = 4 * view.ratio;
  context.strokeStyle = "#fff";
  context.strokeText(text, left, y);
  context.fillStyle = COLOURS.ink;
  context.fillText(text, left, y);
}

/** Draw the agent of a maze with its start, its goal and its way so far. */
function drawAgent(context, film, view, sprites, now) {
  const size = view.scale * view.ratio;
  const time = Math.floor(now);
  const goal = film.goal[0];
  context.fillStyle = COLOURS.reached;
  context.fillRect(...pixelAt(view, goal % film.cols, Math.floor(goal / film.cols)), size, size);
  stamp(context, spriteOf(sprites, "start", size), view, ...placeOf(film, 0, 0));
  drawWay(context, film, view, 0, now);
  const turn = film.headings[Math.min(time + 1, film.steps)] - film.headings[time];
  const heading = film.headings[time] + (((turn + 5) % 4) - 1) * (now - time);
  arrow(context, ...pixelAt(view, ...placeOf(film, 0, now)), size, heading);
}
