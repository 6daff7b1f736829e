"use strict";

const CLICK = 4; // pixels that a click may move before it is a drag

/** Let the stage be dragged, zoomed and clicked. */
function listenToStage(stage) {
  let held = null;
  stage.addEventListener("pointerdown", (event) => {
    if (event.target.closest("button")) return;
    held = {x: event.clientX, y: event.clientY, far: 0};
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!held) return;
    const [right, down] = [event.clientX - held.x, event.clientY - held.y];
    held = {x: event.clientX, y: event.clientY, far: held.far + Math.hypot(right, down)};
    if (state.view.whole || held.far < CLICK) return;
    moveView(state.view, right, down);
    draw();
  });
  stage.addEventListener("pointerup", (event) => {
    if (held && held.far < CLICK && !state.film.headings.length) {
      const box = stage.getBoundingClientRect();
      follow(robotAt(event.clientX - box.left, event.clientY - box.top));
    }
    held = null;
  });
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = stage.getBoundingClientRect();
    zoom(Math.exp(-event.deltaY / 400), event.clientX - box.left, event.clientY - box.top);
  }, {passive: false});
}

/** Let buttons and fields do what they say. */
function listenToControls() {
  const actions = {
    play: () => play(!state.playing), back: () => step(-1), next: () => step(1), fit,
    nearer: () => zoom(ZOOM), farther: () => zoom(1 / ZOOM), nobody: () => follow(null),
  };
  for (const [id, action] of Object.entries(actions)) byId(id)?.addEventListener("click", action);
  byId("scrub").addEventListener("input", (event) => goTo(Number(event.target.value)));
  byId("goals")?.addEventListener("change", draw);
  byId("jams")?.addEventListener("change", draw);
  byId("overlay").addEventListener("change", (event) => {
    showRamp(event.target.value);
    draw();
  });
  byId("robot")?.addEventListener("input", (event) => {
    const {value} = event.target;
    const known = /^\d+$/.test(value) && Number(value) < state.film.agents;
    if (known || value === "") {
      state.followed = known ? Number(value) : null;
      look();
    }
  });
  document.addEventListener("keydown", pressed);
}

/** Draw the charts of a fleet. */
function drawCharts(film) {
  const [throughput, waiting] = [byId("chart-throughput"), byId("chart-waiting")];
  if (!throughput) return;
  drawChart(throughput, facts.ends, facts.throughput, (value) => `${Number(value.toPrecision(2))}`);
  const waits = meansOf(film.waitsBy, facts.ends, film.agents);
  drawChart(waiting, facts.ends, waits, (value) => `${Number((100 * value).toPrecision(2))}%`);
  for (const chart of [throughput, waiting]) listenToChart(chart, goTo);
}

/** Read the film, show its first picture, then listen. */
async function start() {
  const film = await readFilm();
  const stage = byId("stage");
  const canvases = [byId("ground"), byId("robots")];
  Object.assign(state, {film, view: makeView(film.rows, film.cols), ground: makeGround(film)});
  drawCharts(film);
  drawLegend();
  listenToStage(stage);
  listenToControls();
  new ResizeObserver(() => {
    resizeView(state.view, stage, canvases);
    draw();
    if (!performance.getEntriesByName("shown").length) performance.mark("shown");
  }).observe(stage);
}

start();
