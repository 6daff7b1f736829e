"use strict";

const RAMPS = {usage: [92, 38, 150], waiting: [165, 15, 21]}; // red, green, blue of most time
const LINES = "#00000018";
const EDGE = "#9aa0a6";
const LINES_FROM = 9; // CSS pixels of a cell from which lines between cells help
const BEND = 0.7; // power of the share of time: rare use is seen, too
const TOP = 0.995; // of the cells that are used lie below the darkest colour

/** Prepare the floor: the tiles, one pixel each, and counters of what happened on them. */
function makeGround(film) {
  const tiles = document.createElement("canvas");
  drawTiles(tiles, film.tiles, film.rows, film.cols, facts.colours);
  const heat = document.createElement("canvas");
  [heat.width, heat.height] = [film.cols, film.rows];
  return {tiles, heat, counts: {}, tops: {}, drawn: ""};
}

/** Count on each cell who was there, or waited there, until a timestep. */
function countUntil(film, counter, kind, time) {
  if (counter.time > time) {
    counter.cells.fill(0);
    counter.time = 0;
  }
  const {agents, position, waited} = film;
  for (let at = counter.time * agents; at < time * agents; at++) {
    if (kind === "usage" || waited[at]) counter.cells[position[at + agents]]++;
  }
  counter.time = time;
  return counter.cells;
}

/** Make a counter of a kind that has counted nothing yet. */
function newCounter(film) {
  return {time: 0, cells: new Uint32Array(film.rows * film.cols)};
}

/** Find the count that is drawn darkest, the same at all times: so the picture builds up. */
function topOf(film, ground, kind) {
  if (!ground.tops[kind]) {
    const cells = countUntil(film, newCounter(film), kind, film.steps);
    const used = cells.filter((count) => count > 0).sort();
    ground.tops[kind] = used.length ? used[Math.floor(TOP * (used.length - 1))] : 1;
  }
  return ground.tops[kind];
}

/** Turn counts into pixels over the tiles that robots drive on. */
function drawHeat(film, ground, kind, time) {
  ground.counts[kind] ??= newCounter(film);
  const cells = countUntil(film, ground.counts[kind], kind, time);
  const image = new ImageData(film.cols, film.rows);
  const top = topOf(film, ground, kind);
  for (let cell = 0; cell < cells.length; cell++) {
    if (!facts.free[film.tiles[cell]]) continue;
    const share = Math.min(cells[cell] / top, 1) ** BEND;
    for (let part = 0; part < 3; part++) {
      image.data[4 * cell + part] = 255 + share * (RAMPS[kind][part] - 255);
    }
    image.data[4 * cell + 3] = 255;
  }
  ground.heat.getContext("2d").putImageData(image, 0, 0);
}

/** Draw lines between the cells, where they are large enough. */
function drawLines(context, view) {
  context.beginPath();
  for (let column = 0; column <= view.cols; column++) {
    context.rect(Math.round((view.x + column * view.scale) * view.ratio), view.y * view.ratio, 1,
      view.rows * view.scale * view.ratio);
  }
  for (let row = 0; row <= view.rows; row++) {
    context.rect(view.x * view.ratio, Math.round((view.y + row * view.scale) * view.ratio),
      view.cols * view.scale * view.ratio, 1);
  }
  context.fillStyle = LINES;
  context.fill();
}

/** Draw the floor, unless it is drawn already. */
function drawGround(canvas, film, ground, view, kind, time) {
  const wanted = [view.x, view.y, view.scale, canvas.width, canvas.height, kind, kind && time].join();
  if (wanted === ground.drawn) return;
  ground.drawn = wanted;
  const context = canvas.getContext("2d");
  const place = [view.x, view.y, view.cols * view.scale, view.rows * view.scale]
    .map((one) => one * view.ratio);
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.imageSmoothingEnabled = false;
  context.drawImage(ground.tiles, ...place);
  if (kind) {
    drawHeat(film, ground, kind, time);
    context.drawImage(ground.heat, ...place);
  }
  if (view.scale >= LINES_FROM) drawLines(context, view);
  context.strokeStyle = EDGE;
  context.strokeRect(place[0] - 0.5, place[1] - 0.5, place[2] + 1, place[3] + 1);
}
