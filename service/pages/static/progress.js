// How far long work is.

import { h } from "./dom.js";
import { seconds } from "./format.js";

export const progress = (told) => (!told ? "not begun" : h("div", {},
  h("progress", { max: Math.max(told.total, 1), value: told.done, "aria-label": told.what }),
  h("div", { class: "small" }, `${told.what}: ${told.done} of ${told.total} steps${told.seconds_left === null ? "" : `, ${seconds(told.seconds_left)} left at most`}`)));
