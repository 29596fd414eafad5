// Charts over hours: lines, bands and readings, with axes, units, a legend and a table beside.

import uPlot from "./vendor/uPlot.esm.js";
import { aside, colour, h, s, scroll, table } from "./dom.js";
import { axis, hours, hoursAlone, labels, plain, unit } from "./format.js";

/** How readings are marked: a shape for each kind, told apart without colour. */
export const MARKS = {
  counts: ["reading that counts", "total", "M-4 0 A4 4 0 1 0 4 0 A4 4 0 1 0 -4 0 Z", true],
  late: ["late: came after later hours", "late", "M0 -5.5 L5.5 4 L-5.5 4 Z", true],
  corrects: ["corrects another", "parameters", "M-4 -4 H4 V4 H-4 Z", true],
  replaced: ["replaced: does not count", "over", "M-4 -4 L4 4 M-4 4 L4 -4", false],
  retracted: ["retracted: does not count", "over", "M-5 0 H5 M0 -5 V5 M-4 -4 H4 V4 H-4 Z", false],
};

const swatch = (kind, name) => {
  const ink = colour(name) || name;
  const shapes = {
    line: s("path", { d: "M0 6 H22", stroke: ink, "stroke-width": 2 }),
    dash: s("path", { d: "M0 6 H22", stroke: ink, "stroke-width": 2, "stroke-dasharray": "6 3" }),
    dot: s("path", { d: "M0 6 H22", stroke: ink, "stroke-width": 2, "stroke-dasharray": "2 3" }),
    strong: s("rect", { width: 22, height: 12, fill: `rgba(${colour("band")}, 0.38)` }),
    light: s("rect", { width: 22, height: 12, fill: `rgba(${colour("band")}, 0.16)` }),
  };
  return s("svg", { width: 22, height: 12, "aria-hidden": "true" }, shapes[kind]);
};

const mark = (kind) => {
  const [, ink, d, filled] = MARKS[kind];
  return s("svg", { width: 14, height: 14, viewBox: "-7 -7 14 14", "aria-hidden": "true" },
    s("path", { d, stroke: colour(ink), "stroke-width": 1.6, fill: filled ? colour(ink) : "none" }));
};

export const legend = (entries) =>
  h("ul", { class: "legend" }, entries.map(([kind, name, text]) =>
    h("li", {}, kind === "mark" ? mark(name) : swatch(kind, name), text)));

function axes(what, unitName) {
  const common = { stroke: colour("soft"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("line"), width: 1 }, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelGap: 2 };
  return [
    { ...common, label: "operating hours [h]", size: 34, labelSize: 20, space: 70, values: (_, ticks) => labels(ticks) },
    { ...common, label: axis(what, unitName), size: 58, labelSize: 22, values: (_, ticks) => labels(ticks) },
  ];
}

const DASH = { line: [], dash: [8, 4], dot: [2, 4] };
const sizer = new ResizeObserver((entries) => {
  for (const entry of entries) {
    const plot = entry.target.plot;
    const width = Math.floor(entry.contentRect.width);
    if (plot && width > 50 && width !== plot.width) plot.setSize({ width, height: plot.height });
  }
});

/**
 * A chart. time: hours; lines: [{name, values, ink, way}]; bands: [[upper, lower, strength]] of
 * values; marks: [{kind, time_h, value, text}], which set the scale where they count, and else stand
 * at its edge with their value; across: levels [{value, name}].
 */
export function chart(place, { time, lines, bands = [], marks = [], across = [], what, unitName, height = 320, label, least = null }) {
  const old = place.plot;
  if (old) old.destroy();
  const data = [time, ...lines.map((line) => line.values)];
  const series = [{}, ...lines.map((line) => ({ label: line.name, stroke: colour(line.ink), width: 2, dash: DASH[line.way ?? "line"], points: { show: false } }))];
  const between = [];
  for (const [upper, lower, strength] of bands) {
    data.push(upper, lower);
    series.push({ stroke: null, width: 0, points: { show: false } }, { stroke: null, width: 0, points: { show: false } });
    between.push({ series: [data.length - 2, data.length - 1], fill: `rgba(${colour("band")}, ${strength})` });
  }
  const counts = (one) => MARKS[one.kind][3];
  const extra = [...marks.filter(counts).map((m) => m.value), ...across.map((a) => a.value)];
  const readout = h("div", { class: "readout", "aria-hidden": "true" });
  const draw = (u) => {
    const { ctx } = u;
    const ratio = devicePixelRatio;
    ctx.save();
    ctx.beginPath();
    ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    ctx.clip();
    for (const level of across) {
      const y = u.valToPos(level.value, "y", true);
      ctx.strokeStyle = colour("bad-ink");
      ctx.lineWidth = 1.5 * ratio;
      ctx.setLineDash([10 * ratio, 4 * ratio]);
      ctx.beginPath();
      ctx.moveTo(u.bbox.left, y);
      ctx.lineTo(u.bbox.left + u.bbox.width, y);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.fillStyle = colour("bad-ink");
      ctx.font = `${12 * ratio}px system-ui, sans-serif`;
      ctx.textAlign = "left";
      ctx.textBaseline = "bottom";
      ctx.fillText(level.name, u.bbox.left + 6 * ratio, y - 2 * ratio);
    }
    for (const one of marks) {
      const [, ink, d, filled] = MARKS[one.kind];
      const { min, max } = u.scales.y, beyond = one.value > max ? 1 : one.value < min ? -1 : 0;
      const x = u.valToPos(one.time_h, "x", true), y = u.valToPos(Math.min(max, Math.max(min, one.value)), "y", true);
      ctx.setTransform(ratio, 0, 0, ratio, x, y + 9 * ratio * beyond);
      const shape = new Path2D(d);
      ctx.lineWidth = 1.6;
      ctx.strokeStyle = colour("panel");
      if (filled) {
        ctx.fillStyle = colour(ink);
        ctx.fill(shape);
      } else ctx.strokeStyle = colour(ink);
      ctx.stroke(shape);
      if (beyond) { // at the edge, with its value
        const right = x > u.bbox.left + 0.85 * u.bbox.width;
        ctx.fillStyle = colour(ink);
        ctx.font = "12px system-ui, sans-serif";
        [ctx.textAlign, ctx.textBaseline] = [right ? "right" : "left", "middle"];
        ctx.fillText(`${beyond > 0 ? "↑" : "↓"} ${plain(one.value)}`, right ? -9 : 9, 0);
      }
    }
    ctx.restore();
  };
  const tell = (u) => {
    const { idx } = u.cursor;
    readout.textContent = idx === null || idx === undefined ? "" : `${hours(time[idx])}: ${lines.map((line) => `${line.name} ${plain(line.values[idx])}`).join(", ")} ${unit(unitName)}`;
  };
  const holder = h("div", { class: "chart", role: "img", "aria-label": label });
  place.replaceChildren(holder, readout);
  const plot = new uPlot({
    width: Math.max(200, Math.floor(place.clientWidth)), height, series, bands: between, axes: axes(what, unitName),
    scales: { x: { time: false }, y: { range: (_, low, high) => {
      const all = [low, high, ...extra].filter((v) => v !== null && Number.isFinite(v));
      const bottom = least === null ? Math.min(...all) : Math.min(least, ...all);
      const top = Math.max(...all, bottom + 1e-12);
      const pad = 0.05 * (top - bottom);
      return [least !== null && bottom === least ? least : bottom - pad, top + pad];
    } } },
    legend: { show: false }, cursor: { drag: { x: true, y: false }, points: { size: 7 } }, padding: [8, 26, 0, 0],
    hooks: { draw: [draw], setCursor: [tell] },
  }, data, holder);
  place.plot = plot;
  sizer.observe(place);
  return plot;
}

/** The numbers of a chart as a table that opens. */
export function numbers(title, time, lines, unitName) {
  const columns = [
    { name: "Hours [h]", value: (i) => hoursAlone(time[i]), number: true },
    ...lines.map((line) => ({ name: axis(line.name, unitName), value: (i) => plain(line.values[i], 4), number: true })),
  ];
  return aside(title, scroll(title, table(columns, time.map((_, i) => i))));
}
