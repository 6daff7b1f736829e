"use strict";

const PACE = 160; // milliseconds of a step

/** Show how A or B grew, and what its repair changed. */
async function showGrowth(rows) {
  const place = rows[state.focus] === null ? 1 - state.focus : state.focus;
  const row = rows[place];
  [0, 1].forEach((k) => {
    byId(`focus-${k}`).setAttribute("aria-pressed", String(k === place));
    byId(`focus-${k}`).disabled = rows[k] === null;
  });
  byId("growth").style.visibility = row === null ? "hidden" : "visible";
  if (row === null || byId("drawn").dataset.row === String(row)) return;
  stopGrowth();
  const [layouts, frames] = await Promise.all([layoutsOf(row), growthOf(row)]);
  if (!shownRows().includes(row)) return;
  byId("drawn").dataset.row = String(row);
  Object.assign(state, {frames, drawn: layouts.drawn, repaired: layouts.repaired});
  byId("growth-note").replaceChildren(...growthNote(row));
  byId("player").hidden = frames === null;
  byId("step").max = facts.growth.steps;
  showStep(facts.growth.steps);
  showRepaired();
}

/** Say why nothing grows, or what is odd about it, and which command adds what is missing. */
function growthNote(row) {
  const {steps, differing: odd} = facts.growth;
  if (steps === 0) return ["This run searched the tiles themselves: nothing grew."];
  if (!state.grownAt.has(row)) {
    return [`The growth of this one is not in the page, which has ${state.grownAt.size} of ${facts.elites}. For all: `, element("code", facts.enlarge)];
  }
  return [odd[row] ? `Grown again, it ended otherwise than in the run, in ${odd[row]} cells.` : ""];
}

/** Show the layout after so many steps. */
function showStep(step) {
  const last = step >= facts.growth.steps;
  const tiles = state.frames ? state.frames[step] : state.drawn;
  const changed = last ? differing(tiles, state.repaired) : [];
  drawLayout(byId("drawn"), tiles, changed);
  byId("drawn").setAttribute("aria-label", `layout after ${step} steps of growth`);
  byId("step").value = step;
  const whole = facts.growth.steps ? `grown: after ${step} of ${facts.growth.steps} steps` : "as it was searched";
  byId("drawn-caption").textContent = whole;
  byId("back").disabled = step === 0;
  byId("forth").disabled = last;
}

/** Show the layout after the repair, with what it changed. */
function showRepaired() {
  const changed = differing(state.drawn, state.repaired);
  drawLayout(byId("repaired"), state.repaired, changed);
  byId("repaired").setAttribute("aria-label", "layout after the repair");
  const cells = `${changed.length} cell${changed.length === 1 ? "" : "s"} changed`;
  byId("repaired-caption").textContent = `repaired: ${cells}`;
}

/** The step that is shown. */
function stepNow() {
  return Number(byId("step").value);
}

/** Stop playing. */
function stopGrowth() {
  clearInterval(state.timer);
  state.timer = null;
  byId("play").textContent = "Play";
}

/** Play from here, from the start where it has ended, or pause. */
function playGrowth() {
  if (state.timer) return stopGrowth();
  if (stepNow() >= facts.growth.steps) showStep(0);
  byId("play").textContent = "Pause";
  state.timer = setInterval(() => {
    showStep(stepNow() + 1);
    if (stepNow() >= facts.growth.steps) stopGrowth();
  }, PACE);
}

/** Go one step on or back. */
function stepBy(count) {
  stopGrowth();
  showStep(stepNow() + count);
}

/** Let the buttons of growth work. */
function listenToGrowth() {
  byId("growth-title").textContent = facts.growth.steps ? "How it grew" : "Before and after the repair";
  byId("repaired").closest("figure").hidden = !facts.repairs;
  byId("play").addEventListener("click", playGrowth);
  byId("back").addEventListener("click", () => stepBy(-1));
  byId("forth").addEventListener("click", () => stepBy(1));
  byId("step").addEventListener("input", () => { stopGrowth(); showStep(stepNow()); });
  [0, 1].forEach((place) => byId(`focus-${place}`).addEventListener("click", () => {
    state.focus = place;
    showGrowth(shownRows());
  }));
}
