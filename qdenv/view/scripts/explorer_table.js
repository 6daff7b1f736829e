"use strict";

const WIDE = 190; // units of a strip of runs
const TALL = 30;

/** Make an element with a text in it. */
function element(name, text = "", kind = "") {
  const made = document.createElement(name);
  made.textContent = text;
  made.className = kind;
  return made;
}

/** List the numbers of the elites that are shown next to one another. */
function showTable(rows) {
  const table = byId("table");
  const both = rows.every((row) => row !== null);
  const head = ["", "A", "B", both ? "B \u2212 A" : ""].map((text) => element("th", text));
  const lines = facts.columns.map((column, k) => tableLine(column, k, rows, both));
  if (facts.runs) lines.splice(facts.axes.length + 1, 0, runsLine(rows));
  table.replaceChildren(lineOf(head), ...lines);
}

/** Put cells into a line of the table. */
function lineOf(cells) {
  const line = element("tr");
  line.append(...cells);
  return line;
}

/** One number of the elites, and by how much it differs. */
function tableLine(column, k, rows, both) {
  const values = rows.map((row) => (row === null ? NaN : state.values[k][row]));
  const cells = rows.map((row, side) => element("td", row === null ? "" : said(column, values[side])));
  const difference = both ? signed(values[1] - values[0], column.form) : "";
  return lineOf([element("td", column.label), ...cells, element("td", difference)]);
}

/** Write a number with what helps to read it: an interval of a rate, a share of all cells. */
function said(column, value) {
  const text = written(value, column.form);
  if (column.key === "changed") return `${text} (${(100 * value / AREA).toFixed(1)} %)`;
  if (column.key !== "success" || !facts.wilson.length) return text;
  const runs = facts.wilson.length - 1;
  const good = Math.round(value * runs);
  const [low, high] = facts.wilson[good].map((share) => Math.round(100 * share));
  return `${good} of ${runs} (${low}\u2013${high}\u00a0%)`;
}

/** Write a difference with its sign. */
function signed(value, form) {
  if (!Number.isFinite(value)) return "";
  const text = written(Math.abs(value), form);
  return parseFloat(text) === 0 ? text : `${value > 0 ? "+" : "\u2212"}${text}`;
}

/** The line of the table that shows every run. */
function runsLine(rows) {
  const {label, count} = facts.runs;
  const name = label.replace(/ \[.*/, "");
  const runs = rows.map((row) => (row === null ? [] : runsOf(row)));
  const ends = runs.filter((values) => values.length).flatMap((values) => {
    const {mean, half} = meanOf(values);
    return [mean - half, mean + half, ...values];
  });
  const range = [Math.min(...ends), Math.max(...ends)];
  const cells = runs.map((values) => {
    const cell = element("td");
    if (values.length) cell.append(...strip(values, range));
    return cell;
  });
  const about = count > 1 ? `${name} in each of ${count} runs, mean and 95 % interval` : `${name} in the only run`;
  return lineOf([element("td", about), ...cells, element("td")]);
}

/** Draw runs as dots on a line, their mean and its interval, with both in words. */
function strip(values, [from, to]) {
  const {mean, half} = meanOf(values);
  const span = to - from || 1;
  const x = (value) => (6 + (WIDE - 12) * (value - from) / span).toFixed(1);
  const words = values.length > 1 ? `${written(mean)} \u00b1 ${half.toPrecision(2)}` : written(mean);
  const dots = values.map((value) => `<circle cx="${x(value)}" cy="9" r="3.5"/>`).join("");
  const holder = element("div");
  holder.innerHTML = `<svg viewBox="0 0 ${WIDE} ${TALL}" role="img" aria-label="${words}">
    <line x1="0" x2="${WIDE}" y1="9" y2="9" stroke="#d9dce1"/>
    <rect x="${x(mean - half)}" width="${Math.max(0, x(mean + half) - x(mean - half))}" y="3" height="12" fill="#0b66c3" opacity="0.18"/>
    <line x1="${x(mean)}" x2="${x(mean)}" y1="1" y2="17" stroke="#0b66c3" stroke-width="2"/>
    <g fill="#222" fill-opacity="0.55">${dots}</g>
    <g font-size="10" fill="#6b7280"><text x="0" y="28">${written(from)}</text>
    <text x="${WIDE}" y="28" text-anchor="end">${written(to)}</text></g></svg>`;
  return [element("div", words), holder.firstElementChild];
}
