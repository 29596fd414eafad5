// The service now: what waits, who works, what is stuck and how to free it.

import { Problem, get, offers, path, post } from "./api.js";
import { $, facts, h, panel, scroll, show, table } from "./dom.js";
import { fixed, number, plain, seconds } from "./format.js";
import { changes, keep } from "./live.js";
import { progress } from "./progress.js";
import { since } from "./since.js";
import { badge, notices } from "./states.js";

const link = (rotor) => (rotor ? h("a", { href: path`/rotors/${rotor}` }, rotor) : "–");
const said = h("p", { role: "status", class: "small" });

async function act(what, url) {
  try {
    await post(url);
    said.textContent = `${what}: accepted.`;
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    said.textContent = `${what}: ${error.message}`;
  }
  redraw();
}

function blockedPanel(blocked, canRetry, canRetract) {
  if (blocked.length === 0) return panel("Blocked", badge("ok", "no rotor is blocked"));
  const columns = [
    { name: "Rotor", value: (r) => link(r.id), sort: (r) => r.id },
    { name: "Why", value: (r) => r.last_error?.error ?? "not told" },
    { name: "Entry", value: (r) => r.last_error?.event ?? "not known" },
    { name: "Not applied", value: (r) => fixed(r.head_seq - r.applied_seq, 0), number: true },
    { name: "Remedy", value: (r) => h("span", { class: "controls" },
      canRetry ? h("button", { type: "button", onclick: () => act(`Try ${r.id} again`, path`/v1/rotors/${r.id}/retry`) }, "Try again") : null,
      canRetract && r.last_error?.event && !r.last_error.event.includes("/")
        ? h("button", { type: "button", onclick: () => {
            if (confirm(`Retract ${r.last_error.event}, as if it had never come?`)) act(`Retract ${r.last_error.event}`, path`/v1/rotors/${r.id}/inspections/${r.last_error.event}/retraction`);
          } }, `Retract ${r.last_error.event}`) : null) },
  ];
  return panel("Blocked", h("p", {}, "Nothing new is applied to these until the entry is retracted, corrected or (adoptions) backed out, or they are tried again."), scroll("Blocked rotors", table(columns, blocked)));
}

const news = changes();
async function draw() {
  const [found, ready, canRetry, canRetract] = await Promise.all([
    get("/v1/operations", { limit: 100 }), get("/readyz").catch((error) => ({ ready: false, remedy: error.message })),
    offers("post", "/v1/rotors/{r}/retry"), offers("post", "/v1/rotors/{r}/inspections/{i}/retraction")]);
  const g = found.gauges;
  const changed = news([found, ready, canRetry, canRetract]);
  const idle = g.backlog > 0 && found.work.length === 0;
  notices([!ready.ready && ["bad", "The service is not ready.", ready.remedy ?? ready.database],
    idle && g.oldest_s > 10 && ["warn", `${number(g.backlog, "entry waits", "entries wait")} and no worker holds a lease.`, "Blocked rotors aside, start one: bladetwin worker."]]);
  if (!changed) return;
  show($("states"), badge(g.blocked ? "bad" : "ok", g.blocked ? `${number(g.blocked, "rotor")} blocked` : "none blocked"),
    badge(g.backlog ? "wait" : "ok", g.backlog ? `backlog ${fixed(g.backlog, 0)}` : "no backlog"));
  const now = panel("Now", facts([
    ["Rotors", fixed(g.rotors, 0)],
    ["Backlog", `${number(g.backlog, "entry", "entries")}${g.backlog ? `, the oldest for ${seconds(g.oldest_s)}` : ""}`],
    ["Rotors with work", fixed(g.dirty, 0)],
    ["Provisional", fixed(g.provisional, 0)],
    ...(g.outdated ? [["Of an older algorithm", `${number(g.outdated, "rotor")}; computed anew where nothing else is to be done`]] : []),
    ["Jobs", fixed(g.jobs, 0)],
    ["Entries applied", fixed(g.applied, 0)],
    ["Versions written", `${fixed(g.versions, 0)}, ${fixed(g.seals, 0)} of them sealed`],
    ["Diagnoses", `${fixed(g.diagnosed, 0)} done${g.undiagnosed ? `, ${fixed(g.undiagnosed, 0)} failed` : ""}`],
    ["Adoptions", `${fixed(g.adoptions, 0)}${g.back_outs ? `, ${fixed(g.back_outs, 0)} backed out` : ""}`],
    ["Leases taken over", fixed(g.takeovers, 0)],
    ["Least effective share", g.least_ess_ratio === null ? "–" : plain(g.least_ess_ratio)],
  ]));
  const work = panel("Workers at work", found.work.length
    ? scroll("Workers", table([
        { name: "Worker", value: (w) => w.owner, sort: (w) => w.owner },
        { name: "Does", value: (w) => w.does, sort: (w) => w.does },
        { name: "Rotor", value: (w) => link(w.rotor_id), sort: (w) => w.rotor_id },
        { name: "Behind", value: (w) => (w.behind === null ? "–" : fixed(w.behind, 0)), number: true },
        { name: "Lease for", value: (w) => seconds(w.lease_s), number: true },
      ], found.work))
    : h("p", { class: "soft" }, g.backlog ? "Nobody holds a lease at this moment." : "Nobody: there is nothing to do. Workers that wait hold no lease and are not listed."));
  const jobs = panel("Jobs that go on", found.jobs.length
    ? scroll("Jobs", table([
        { name: "Job", value: (j) => (j.kind === "diagnose" && j.rotor ? h("a", { href: path`/rotors/${j.rotor}/diagnoses/${j.id}` }, "diagnosis") : j.kind) },
        { name: "Rotor", value: (j) => link(j.rotor) },
        { name: "State", value: (j) => badge("wait", j.status) },
        { name: "Progress", value: (j) => progress(j.progress) },
        { name: "Asked", value: (j) => since(j.created_at) },
        { name: "Attempts", value: (j) => fixed(j.attempts, 0), number: true },
      ], found.jobs))
    : h("p", { class: "soft" }, "No job is queued or running."));
  show($("page"), said, h("div", { class: "columns wide-left" },
    h("div", { class: "stack" }, blockedPanel(found.blocked, canRetry, canRetract), jobs, work), now));
}

const redraw = keep(draw, { everyS: 3 });
