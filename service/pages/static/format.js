// Numbers with sensible digits, hours, moments.

const NBSP = "\u00a0"; // a number is not broken at the end of a line
const MINUS = "−";

/** With commas for thousands, as the reasons, reports and the terminal have them. */
const grouped = (text) => {
  const [whole, part] = text.split(".");
  const told = whole.replace(/\B(?=(\d{3})+$)/g, ",");
  return part === undefined ? told : `${told}.${part}`;
};

/** A number with so many decimals: 12,345.6, with a true minus sign. */
export function fixed(value, decimals) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const text = grouped(Math.abs(value).toFixed(decimals));
  return value < 0 && Number(value.toFixed(decimals)) !== 0 ? MINUS + text : text;
}

/** Decimals that show a number to so many significant digits. */
export const decimals = (value, digits = 2) => {
  const size = Math.abs(Number(Number(value).toPrecision(digits))); // 0.996 is 1.0, not 1.00
  if (!(size > 0)) return 0;
  return Math.min(9, Math.max(0, digits - 1 - Math.floor(Math.log10(size))));
};

/** A number alone, to three significant digits or so. */
export const plain = (value, digits = 3) => {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value !== 0 && Math.abs(value) < 1e-4) return value.toExponential(digits - 1).replace("-", MINUS);
  return fixed(value, decimals(value, digits));
};

/** A number that somebody gave, with every digit of it. */
export const asGiven = (value) => String(value).replaceAll("-", MINUS);

/** Whether a spread is that of rounding alone: all particles have one value. */
export const same = (value, sd) => sd <= 1e-9 * Math.abs(value);

/** mean ± sd: as many decimals as make two digits of the sd. */
export function withSd(mean, sd) {
  if (sd > 0 && same(mean, sd)) return `${plain(mean)} ± 0`;
  const places = sd > 0 ? decimals(sd, 2) : decimals(mean, 3);
  if (sd > 0 && sd < 1e-5) return `${mean.toExponential(2)} ± ${sd.toExponential(0)}`.replaceAll("-", MINUS);
  return `${fixed(mean, places)} ± ${fixed(sd, places)}`;
}

/** A unit; dimensionless quantities have none to show. */
export const unit = (name) => (!name || name === "1" ? "" : name);
export const inUnit = (text, name) => (unit(name) ? `${text}${NBSP}${name}` : text);
export const axis = (what, name) => `${what} [${unit(name) || "1"}]`;

/** Hours without their unit: no decimals from a hundred on, three digits below. */
export const hoursAlone = (value) => (Math.abs(value) >= 100 || Number.isInteger(value) ? fixed(value, 0) : plain(value, 3));
export const hours = (value) => (value === null || value === undefined ? "–" : `${hoursAlone(value)}${NBSP}h`);

/** Hours, to a thousandth of the last one or finer: of 50,000 h to 10 h, of 12 h to 0.01 h. */
export function hoursOf(value, last) {
  const power = last > 0 ? Math.max(-6, Math.floor(Math.log10(last)) - 3) : 0;
  const shown = power < 0 ? fixed(value, -power) : fixed(Math.round(value / 10 ** power) * 10 ** power, 0);
  return `${shown}${NBSP}h`;
}

export function seconds(value) {
  if (value === null || value === undefined) return "–";
  if (value < 90) return `${fixed(value, value < 10 ? 1 : 0)}${NBSP}s`;
  if (value < 5400) return `${fixed(value / 60, 0)}${NBSP}min`;
  if (value < 172800) return `${fixed(value / 3600, 1)}${NBSP}h`;
  return `${fixed(value / 86400, 0)}${NBSP}d`;
}

export const moment = (text) => {
  if (!text) return "–";
  const at = new Date(text);
  return Number.isNaN(at.getTime()) ? String(text) : `${at.toISOString().slice(0, 19).replace("T", " ")}${NBSP}UTC`;
};

export const ago = (text) => {
  const at = Date.parse(text ?? "");
  return Number.isNaN(at) ? "–" : `${seconds(Math.max(0, (Date.now() - at) / 1000))} ago`;
};

export const words = (name) => String(name).replaceAll("_", " ");

export const number = (count, one, many = `${one}s`) => `${fixed(count, 0)} ${count === 1 ? one : many}`;

/** A chance, to whole percents in the middle and to tenths at both ends. */
export function percent(share) {
  if (share === null || share === undefined || Number.isNaN(share)) return "–";
  if (share < 0.001) return `<${NBSP}0.1${NBSP}%`;
  if (share > 0.999) return `>${NBSP}99.9${NBSP}%`;
  return `${fixed(100 * share, share >= 0.0095 && share <= 0.9905 ? 0 : 1)}${NBSP}%`;
}

/** Ticks of an axis with as many decimals as tell them apart. */
export function labels(values) {
  const step = values.length > 1 ? Math.abs(values[1] - values[0]) : Math.abs(values[0] ?? 0);
  const largest = Math.max(...values.map(Math.abs), 0);
  if (step > 0 && (step < 1e-4 || largest >= 1e6)) return values.map((v) => (v === 0 ? "0" : v.toExponential(1).replace("-", MINUS)));
  let places = 0;
  while (places < 6 && Math.abs(step * 10 ** places - Math.round(step * 10 ** places)) > 1e-6) places += 1;
  return values.map((v) => fixed(v, places));
}
