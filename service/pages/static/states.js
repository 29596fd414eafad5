// States as signs, words and colours; a wrong state is told before anything is drawn.

import { $, h, show } from "./dom.js";
import { number } from "./format.js";

const SIGNS = { ok: "✓", wait: "◔", warn: "▲", bad: "✕" };

export const badge = (kind, text, title) =>
  h("span", { class: `state ${kind}`, title }, h("span", { "aria-hidden": "true" }, SIGNS[kind]), text);

/** How a rotor stands, the gravest first: [kind, words, what it means or what to do]. */
export function statesOf(rotor) {
  const found = [];
  const behind = rotor.head_seq - rotor.applied_seq;
  if (rotor.status === "blocked") found.push(["bad", "blocked", rotor.last_error?.error ?? ""]);
  const health = rotor.health;
  if (health && !health.trusted) found.push(["bad", `not trusted: ${health.status}`, (health.reasons ?? []).join("; ")]);
  if (rotor.version === 0) found.push(["wait", "no posterior yet", "a worker has yet to compute the first one"]);
  if (behind > 0) found.push([rotor.status === "blocked" ? "bad" : "wait", `${number(behind, "entry", "entries")} not applied`, "what is shown does not rest on them"]);
  if (rotor.posterior && !rotor.posterior.sealed) found.push(["wait", "provisional", "a sealed posterior follows by itself"]);
  if (found.length === 0 && (rotor.posterior?.sealed || rotor.status === "current")) found.push(["ok", rotor.posterior ? "sealed, all applied" : "all applied", ""]);
  return found;
}

export const badges = (states) => states.map(([kind, text, title]) => badge(kind, text, title));

let noticed = "[]";

/** Notices above the page: what is wrong and what to do about it. What stands there is not said again. */
export function notices(given) {
  const text = JSON.stringify(given.filter(Boolean));
  if (text === noticed) return;
  noticed = text;
  show($("notice"), given.filter(Boolean).map(([kind, ...lines]) =>
    h("div", { class: `notice ${kind}` }, lines.filter(Boolean).map((line) => h("p", {}, line)))));
}

/** What takes away the entry that stops a rotor; none: it is not known. */
function undoing(event) {
  if (!event) return "retract or correct the entry";
  if (event.startsWith("adoption/")) return "back out what was adopted last, on the page of its diagnosis (Diagnoses)";
  if (event.includes("/")) return "no entry can be taken back for it, so see what the error says (the server's log has more)";
  return `retract or correct the entry ${event}`;
}

/** What of a rotor's state has to be told in words. */
export function warningsOf(rotor) {
  const out = [];
  if (rotor.status === "blocked") {
    const error = rotor.last_error ?? {};
    out.push(["bad", `Blocked after ${number(rotor.attempts, "attempt")}${error.event ? ` by entry ${error.event}` : ""}: nothing new is applied.`,
      error.error, `To mend it: ${undoing(error.event)}, or try again (Operations). What is shown is the last version.`]);
  }
  const health = rotor.health;
  if (health && !health.trusted) {
    out.push(["bad", `This posterior is not to be trusted (${health.status}).`, (health.reasons ?? []).join("; ")]);
  }
  for (const { name, untold = [] } of rotor.effects ?? []) {
    if (untold.length) out.push(["warn", `${untold.join(", ")} joined after “${name}” was adopted, which concerns ${untold.length === 1 ? "it" : "them"}.`,
      "The model does not know that: bands of such a blade leave the effect out, or take the blade for one that began with the rotor.", "To mend it: diagnose and adopt anew."]);
  }
  out.push(...shaken(rotor.effects ?? []));
  if (rotor.version === 0) out.push(["wait", "No data yet: a worker has still to compute the first posterior of this rotor. The page fills when it is there."]);
  return out;
}

/** Adopted effects that were found with readings which count no longer, one notice for each diagnosis. */
export function shaken(effects) {
  const found = new Map();
  for (const { name, diagnosis, no_longer: lost = [] } of effects) {
    if (lost.length) found.set(diagnosis, { names: [...(found.get(diagnosis)?.names ?? []), name], lost });
  }
  return [...found.values()].map(({ names, lost }) => ["warn",
    `${number(lost.length, "reading")} with which “${names.join("”, “")}” was found ${lost.length === 1 ? "counts" : "count"} no longer: ${lost.slice(0, 5).join(", ")}${lost.length > 5 ? " …" : ""}.`,
    "The effect is in the model still, with an amplitude by the readings that count.", "To mend it: back it out (on the page of its diagnosis, or bladetwin adopt --back-out), diagnose and adopt anew."]);
}

/** What a page shows where its data could not be had. */
export function failed(problem) {
  const kinds = {
    0: ["bad", "The service is away."],
    401: ["warn", "A key is needed."],
    403: ["warn", "This key may not see that."],
    404: ["warn", "Not found, or not for this key."],
    409: ["wait", "Not computed yet."],
    410: ["warn", "No longer kept."],
  };
  const [kind, title] = kinds[problem.status] ?? ["bad", problem.status >= 500 ? "The service could not answer." : "This could not be read."];
  return [kind, title, problem.message];
}
