// Colours for numbers: cividis, which is read alike with and without colour blindness, and in grey.

const CIVIDIS = [
  [0, 32, 77], [0, 48, 111], [42, 63, 109], [72, 78, 108], [94, 93, 110], [114, 109, 114],
  [134, 124, 117], [154, 140, 117], [177, 158, 110], [201, 177, 99], [226, 197, 82], [255, 234, 70],
];

/** [r, g, b], 0 … 255, for a share 0 … 1. */
export function rgb(share) {
  const at = Math.min(1, Math.max(0, Number.isFinite(share) ? share : 0)) * (CIVIDIS.length - 1);
  const i = Math.min(CIVIDIS.length - 2, Math.floor(at));
  return CIVIDIS[i].map((low, k) => low + (at - i) * (CIVIDIS[i + 1][k] - low));
}

export const css = (share) => `rgb(${rgb(share).map(Math.round).join(", ")})`;

const APART = [[33, 102, 172], [146, 197, 222], [247, 247, 247], [244, 165, 130], [178, 24, 43]];

/** [r, g, b] for a share 0 … 1 of a span around zero: blue below, nearly white at it, red above. */
export function apart(share) {
  const at = Math.min(1, Math.max(0, Number.isFinite(share) ? share : 0.5)) * (APART.length - 1);
  const i = Math.min(APART.length - 2, Math.floor(at));
  return APART[i].map((low, k) => low + (at - i) * (APART[i + 1][k] - low));
}

/** Whether dark writing is read better than light on a colour of the scale. */
export const dark = (share) => share > 0.5;

/** Least and greatest of some numbers; a span of nothing, or of rounding alone, is widened. */
export function span(values) {
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (!(low <= high)) return [0, 1];
  const nothing = high - low <= 1e-12 * Math.max(Math.abs(low), Math.abs(high)); // rounding alone
  return nothing ? [low - Math.abs(low || 1) * 0.05, high + Math.abs(high || 1) * 0.05] : [low, high];
}

export const share = (value, [low, high]) => (value - low) / (high - low);

/** Round steps that cover a span: about `count` of them. */
export function ticks([low, high], count = 5) {
  const raw = (high - low) / count;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * [1, 2, 2.5, 5, 10].find((k) => k * size >= raw * (1 - 1e-9));
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step && out.length < 100; k += 1) out.push(k * step);
  return out;
}
