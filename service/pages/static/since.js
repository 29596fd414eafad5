// How long ago something was, kept true while the page stands.

import { h } from "./dom.js";
import { ago, moment } from "./format.js";

const AGAIN_MS = 10_000;

/** "3 s ago", with the moment as its title. */
export const since = (text) => h("time", { datetime: text, title: moment(text) }, ago(text));

setInterval(() => {
  if (document.hidden) return;
  for (const one of document.querySelectorAll("time[datetime]")) {
    const now = ago(one.dateTime);
    if (one.textContent !== now) one.textContent = now;
  }
}, AGAIN_MS);
