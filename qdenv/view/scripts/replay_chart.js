"use strict";

const CHART = {width: 300, height: 92, left: 34, right: 8, top: 6, bottom: 18};

/** Make an element of SVG. */
function svg(name, attributes, text = "") {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.textContent = text;
  return element;
}

/** Place a timestep on a chart. */
function chartX(time) {
  return CHART.left + (time / facts.steps) * (CHART.width - CHART.left - CHART.right);
}

/** Round a number up to a short one. */
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 1.5, 2, 3, 4, 5, 6, 8, 10].map((one) => one * power).find((one) => one >= value * 0.999);
}

/**
 * Draw numbers over time as steps, congested stretches behind them, and a cursor.
 * ends: where each window of time ends; words: how a value is written at the axis.
 */
function drawChart(chart, ends, values, words) {
  const {width, height, left, right, top, bottom} = CHART;
  const most = roundUp(Math.max(...values, 1e-3));
  const place = (value) => height - bottom - (value / most) * (height - top - bottom);
  chart.setAttribute("viewBox", `0 0 ${width} ${height}`);
  chart.setAttribute("preserveAspectRatio", "none");
  for (const [begin, end] of facts.congested) {
    const band = svg("rect", {x: chartX(begin), y: top, width: chartX(end) - chartX(begin),
      height: height - top - bottom, fill: "#d9301f", opacity: 0.18});
    band.append(svg("title", {}, `congested from ${begin} to ${end}`));
    chart.append(band);
  }
  for (const value of [0, most / 2, most]) {
    chart.append(svg("line", {x1: left, x2: width - right, y1: place(value), y2: place(value),
      stroke: "#d9dce1"}));
    chart.append(svg("text", {x: left - 5, y: place(value) + 3.5, "text-anchor": "end"}, words(value)));
  }
  chart.append(svg("text", {x: left, y: height - 4}, "0"));
  chart.append(svg("text", {x: width - right, y: height - 4, "text-anchor": "end"}, `${facts.steps}`));
  let path = `M${left} ${place(values[0])}`;
  values.forEach((value, index) => (path += `V${place(value)}H${chartX(ends[index])}`));
  chart.append(svg("path", {d: path, fill: "none", stroke: "#1c4e9a", "stroke-width": 1.6}));
  chart.append(svg("line", {class: "cursor", y1: top, y2: height - bottom, stroke: "#1b1b1b",
    "stroke-width": 1.4}));
}

/** Move a chart's cursor to a time. */
function moveCursor(chart, time) {
  const cursor = chart.querySelector(".cursor");
  cursor.setAttribute("x1", chartX(time));
  cursor.setAttribute("x2", chartX(time));
}

/** Average what is summed in `sums` over windows that end at `ends`. */
function meansOf(sums, ends, scale) {
  return ends.map((end, index) => {
    const begin = index ? ends[index - 1] : 0;
    return (sums[end] - sums[begin]) / (end - begin) / scale;
  });
}

/** Let clicks and drags on a chart choose a time. */
function listenToChart(chart, choose) {
  const timeAt = (event) => {
    const box = chart.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * CHART.width;
    return Math.round(((x - CHART.left) / (CHART.width - CHART.left - CHART.right)) * facts.steps);
  };
  chart.addEventListener("pointerdown", (event) => {
    chart.setPointerCapture(event.pointerId);
    choose(timeAt(event));
  });
  chart.addEventListener("pointermove", (event) => {
    if (event.buttons) choose(timeAt(event));
  });
}
