// Models that are registered.

import { pages, path } from "./api.js";
import { $, h, panel, show, table } from "./dom.js";
import { changes, keep } from "./live.js";
import { badge, notices } from "./states.js";

const columns = [
  { name: "Model", value: (m) => h("a", { href: path`/models/${m.id}` }, m.id), sort: (m) => m.id },
  { name: "State", value: (m) => badge(m.state === "ready" ? "ok" : "wait", m.state) },
  { name: "Version", value: (m) => m.version },
  { name: "Digest", value: (m) => h("code", {}, m.digest.slice(0, 16)) },
];

const news = changes();
keep(async () => {
  const found = await pages("/v1/models");
  notices([]);
  if (!news(found)) return;
  show($("page"), panel(null, found.items.length ? table(columns, found.items, { sorted: [0, true] }) : h("p", {}, "No model is registered yet: POST /v1/models.")));
}, { everyS: 30 });
