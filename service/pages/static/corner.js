// Parameters of a blade: prior against posterior, and each pair with its correlation.

import { across, colour, h, scroll, show, table } from "./dom.js";
import { axis, fixed, labels, plain, same, withSd, words } from "./format.js";
import { legend } from "./chart.js";
import { span, ticks } from "./scale.js";
import { density, histogram, quantile } from "./stats.js";

const SMALL = "11px system-ui, sans-serif";

function canvas(width, height, label) {
  const made = h("canvas", { class: "plot", role: "img", "aria-label": label });
  const ratio = Math.max(1, devicePixelRatio);
  made.width = width * ratio;
  made.height = height * ratio;
  made.style.maxWidth = `${width}px`;
  const ctx = made.getContext("2d");
  ctx.scale(ratio, ratio);
  ctx.font = SMALL;
  return [made, ctx];
}

/** How wide the widest of some words is drawn. */
function widest(texts) {
  const ctx = document.createElement("canvas").getContext("2d");
  ctx.font = SMALL;
  return Math.max(...texts.map((text) => ctx.measureText(text).width));
}

/** The declared prior of a parameter, and its unit; null where the network declares none. */
export function declared(network, name) {
  const parameter = network.parameters.find((p) => p.name === name);
  if (parameter) return { prior: parameter.prior, unit: parameter.unit, level: parameter.level };
  const of = name.match(/^sigma_obs\.([^@]+)(@.*)?$/);
  const quantity = of && network.quantities.find((q) => q.name === of[1]);
  return quantity ? { prior: quantity.sigma_obs, unit: quantity.unit, level: "noise" } : null;
}

const priorOf = (prior) => `${words(prior.kind)}${prior.kind === "normal" ? ` ${plain(prior.mean)} ± ${plain(prior.sd)}` : ""}, ${plain(prior.low)} … ${plain(prior.high)}`;

function marginal({ name, values, told, mean, sd }) {
  const sorted = [...values].sort((a, b) => a - b);
  const wide = told ? [told.prior.low, told.prior.high] : span(values);
  // where the posterior is far narrower than the prior, the picture is of the posterior's part
  const inner = [quantile(sorted, 0.005), quantile(sorted, 0.995)]; // few draws far off would make it flat
  const narrow = inner[1] - inner[0] < 0.25 * (wide[1] - wide[0]) && !same(mean, sd);
  const margin = 0.3 * (inner[1] - inner[0]);
  const [low, high] = narrow ? [Math.max(wide[0], inner[0] - margin), Math.min(wide[1], inner[1] + margin)] : wide;
  const [W, H, bottom] = [300, 132, 32];
  const [made, ctx] = canvas(W, H, `${words(name)}: prior and posterior density`);
  const bins = histogram(values, low, high, 28);
  const xs = Array.from({ length: 81 }, (_, i) => low + ((high - low) * i) / 80);
  const prior = told ? xs.map((x) => density(told.prior, Math.min(told.prior.high, Math.max(told.prior.low, x)))) : [];
  const top = 1.08 * Math.max(...bins, ...prior.filter(Number.isFinite).map((v) => Math.min(v, 3 * Math.max(...bins))));
  const X = (x) => 8 + ((x - low) / (high - low)) * (W - 16);
  const Y = (y) => H - bottom - (y / top) * (H - bottom - 4);
  ctx.fillStyle = `rgba(${colour("band")}, 0.45)`;
  bins.forEach((y, i) => ctx.fillRect(X(low + ((high - low) * i) / 28), Y(y), (W - 16) / 28 + 0.4, Y(0) - Y(y)));
  ctx.strokeStyle = colour("prior");
  ctx.lineWidth = 2;
  ctx.setLineDash([6, 3]);
  ctx.beginPath();
  prior.forEach((y, i) => (i ? ctx.lineTo(X(xs[i]), Y(Math.min(y, top))) : ctx.moveTo(X(xs[i]), Y(Math.min(y, top)))));
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.strokeStyle = colour("line");
  ctx.beginPath();
  ctx.moveTo(8, Y(0));
  ctx.lineTo(W - 8, Y(0));
  ctx.stroke();
  ctx.fillStyle = colour("soft");
  ctx.textAlign = "center";
  const at = ticks([low, high], 4);
  labels(at).forEach((text, i) => {
    const half = ctx.measureText(text).width / 2;
    if (X(at[i]) > half && X(at[i]) < W - half) ctx.fillText(text, X(at[i]), H - 19);
  });
  ctx.fillText(axis(words(name), told?.unit), W / 2, H - 4);
  return made;
}

/** Prior against posterior of each parameter. */
export function marginals(place, draws, network) {
  const rows = draws.names.map((name, i) => {
    const values = draws.values.map((row) => row[i]);
    const mean = values.reduce((a, b) => a + b, 0) / values.length;
    const sd = Math.sqrt(values.reduce((a, b) => a + (b - mean) ** 2, 0) / values.length);
    const sorted = [...values].sort((a, b) => a - b);
    return { name, values, mean, sd, low: quantile(sorted, 0.025), high: quantile(sorted, 0.975), told: declared(network, name) };
  });
  const columns = [
    { name: "Parameter", value: (r) => words(r.name), sort: (r) => r.name },
    { name: "Level", value: (r) => r.told?.level ?? "of the rotor's network" },
    { name: "Unit", value: (r) => r.told?.unit ?? "–" },
    { name: "Prior", value: (r) => (r.told ? priorOf(r.told.prior) : "not declared by the model") },
    { name: "Posterior mean ± sd", value: (r) => withSd(r.mean, r.sd), number: true },
    { name: "95 %", value: (r) => `${plain(r.low)} … ${plain(r.high)}`, number: true },
  ];
  show(place, h("div", { class: "columns marginals" }, rows.map(marginal)),
    legend([["strong", "band", "posterior: density of the draws"], ["dash", "prior", "prior density"]]),
    scroll("Parameters", table(columns, rows, { caption: `${draws.values.length} equally weighted draws of ${draws.of} particles` })));
}

function correlation(a, b) {
  const mean = (v) => v.reduce((x, y) => x + y, 0) / v.length;
  const [ma, mb] = [mean(a), mean(b)];
  let [ab, aa, bb] = [0, 0, 0];
  for (let i = 0; i < a.length; i += 1) {
    ab += (a[i] - ma) * (b[i] - mb);
    aa += (a[i] - ma) ** 2;
    bb += (b[i] - mb) ** 2;
  }
  const still = [[ma, aa], [mb, bb]].some(([m, square]) => same(m, Math.sqrt(square / a.length)));
  return still ? null : ab / Math.sqrt(aa * bb);
}

/** Every pair of parameters (no correlation where one of them is the same in all draws): draws below the diagonal, correlations above it. */
export function corner(place, draws) {
  const n = draws.names.length;
  const of = draws.names.map((_, i) => draws.values.map((row) => row[i]));
  const spans = of.map((values) => span(values));
  const called = draws.names.map((name) => words(name).split(/[ .]/));
  const [left, bottom, cell] = [12 + widest(called.flat()), 36 + 13 * Math.max(...called.map((text) => text.length)), Math.min(150, Math.max(90, 600 / n))];
  const size = cell * n;
  const [made, ctx] = canvas(left + size + 8, size + bottom, `Draws of ${n} parameters in pairs; the table below has the correlations`);
  const place1 = (value, [low, high]) => 6 + ((value - low) / (high - low)) * (cell - 12);
  for (let row = 0; row < n; row += 1) {
    for (let col = 0; col < n; col += 1) {
      const [x0, y0] = [left + col * cell, row * cell];
      ctx.strokeStyle = colour("line");
      ctx.lineWidth = 1;
      ctx.strokeRect(x0 + 0.5, y0 + 0.5, cell - 1, cell - 1);
      if (row === col) {
        const bins = histogram(of[row], ...spans[row], 24);
        const top = Math.max(...bins);
        ctx.fillStyle = `rgba(${colour("band")}, 0.5)`;
        bins.forEach((y, i) => {
          const tall = (y / top) * (cell - 14);
          ctx.fillRect(x0 + 6 + (i * (cell - 12)) / 24, y0 + cell - 4 - tall, (cell - 12) / 24 + 0.3, tall);
        });
      } else if (row > col) {
        ctx.fillStyle = `rgba(${colour("band")}, 0.35)`;
        for (let i = 0; i < draws.values.length; i += 1) {
          ctx.fillRect(x0 + place1(of[col][i], spans[col]) - 1, y0 + cell - place1(of[row][i], spans[row]) - 1, 2, 2);
        }
      } else {
        const r = correlation(of[row], of[col]);
        ctx.fillStyle = r >= 0 ? `rgba(${colour("band")}, ${0.5 * Math.abs(r)})` : `rgba(213, 94, 0, ${0.5 * Math.abs(r)})`;
        ctx.fillRect(x0 + 1, y0 + 1, cell - 2, cell - 2);
        ctx.fillStyle = colour("ink");
        ctx.textAlign = "center";
        ctx.font = "14px system-ui, sans-serif";
        ctx.fillText(fixed(r, 2), x0 + cell / 2, y0 + cell / 2 + 5);
        ctx.font = SMALL;
      }
    }
  }
  ctx.fillStyle = colour("soft");
  for (let i = 0; i < n; i += 1) {
    const text = called[i];
    ctx.textAlign = "center";
    text.forEach((word, k) => ctx.fillText(word, left + (i + 0.5) * cell, size + 30 + 13 * k));
    const [few, more] = [ticks(spans[i], 2), ticks(spans[i], 3)];
    const at = few.length > 1 ? few : more; // one mark alone is no scale
    labels(at).forEach((tick, k) => ctx.fillText(tick, Math.min(left + size - 10, left + i * cell + place1(at[k], spans[i])), size + 14));
    ctx.textAlign = "right";
    text.forEach((word, k) => ctx.fillText(word, left - 6, (i + 0.5) * cell + 13 * (k - (text.length - 1) / 2)));
  }
  const columns = [{ name: "", value: (i) => words(draws.names[i]) }, ...draws.names.map((name, j) => ({ name: words(name), value: (i) => fixed(correlation(of[i], of[j]), 2), number: true }))];
  made.style.minWidth = `${Math.round(0.8 * (left + size + 8))}px`; // smaller its words are not read
  show(place, across("Parameters in pairs", made),
    h("p", { class: "small soft" }, "Below the diagonal: draws in natural units. Above: correlation, blue where positive, orange where negative."),
    h("details", {}, h("summary", {}, "Correlations as a table"), scroll("Correlations", table(columns, draws.names.map((_, i) => i)))));
}

