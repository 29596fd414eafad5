// Densities and distributions that pages draw.

const erf = (x) => {
  const t = 1 / (1 + 0.3275911 * Math.abs(x));
  const y = 1 - (((((1.061405429 * t - 1.453152027) * t) + 1.421413741) * t - 0.284496736) * t + 0.254829592) * t * Math.exp(-x * x);
  return x >= 0 ? y : -y;
};
const cdf = (z) => 0.5 * (1 + erf(z / Math.SQRT2));

/** Density of a prior as the network declares it (core.prior), at x. */
export function density(prior, x) {
  const { kind, low, high, mean, sd } = prior;
  if (x < low || x > high) return 0;
  if (kind === "uniform") return 1 / (high - low);
  if (kind === "log_uniform") return 1 / (x * Math.log(high / low));
  const mass = cdf((high - mean) / sd) - cdf((low - mean) / sd);
  return Math.exp(-0.5 * ((x - mean) / sd) ** 2) / (sd * Math.sqrt(2 * Math.PI) * mass);
}

/** Share of a sample in each of `count` equal cells, as a density. */
export function histogram(values, low, high, count) {
  const bins = new Array(count).fill(0);
  const width = (high - low) / count;
  for (const value of values) {
    const i = Math.floor((value - low) / width);
    if (i >= 0 && i < count) bins[i] += 1 / (values.length * width);
    else if (value === high) bins[count - 1] += 1 / (values.length * width);
  }
  return bins;
}

export const quantile = (sorted, p) => sorted[Math.min(sorted.length - 1, Math.floor(p * sorted.length))];
