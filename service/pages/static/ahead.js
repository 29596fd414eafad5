// How far a page looks ahead where nobody chose an hour: a wide model's runs end far beyond any blade.

const USUAL_H = 50_000;

/** The hour; latest: of the readings, which are never cut off. */
export const usual = (model, latest = 0) =>
  (latest > USUAL_H ? model.horizon_h : Math.min(model.horizon_h, USUAL_H));

/** Hours of a course to there, as a query has them; null: all of the model's. */
export function usualHours(model, latest = 0) {
  const end = usual(model, latest);
  return end < model.horizon_h ? [...model.time_h.filter((hour) => hour < end), end].join(",") : null;
}
