// The pictures of a diagnosis' report, on its page: drawn once, by the service, for both.

import { ask } from "./api.js";
import { h, panel } from "./dom.js";

let kept = null;

/** The report's text; a diagnosis that is done does not change, so it is read once. */
function text(url) {
  kept ??= ask("GET", `${url}/report`).then((answer) => answer.text()).catch((error) => { kept = null; throw error; });
  return kept;
}

/**
 * A panel for each section of the report that has pictures, with these, what stands below them, and
 * the sentences that are told beside them.
 * The report's own style sheet goes with them, and holds for them alone.
 */
export async function pictures(url) {
  const [head, style, body] = (await text(url)).split(/<\/?style>/);
  const report = new DOMParser().parseFromString(head + body, "text/html");
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(style.replaceAll(":root", ":host"));
  return [...report.querySelectorAll("section")].filter((one) => one.querySelector("figure")).map((section) => {
    const place = h("div", { class: "pictured" });
    const inside = place.attachShadow({ mode: "open" });
    inside.adoptedStyleSheets = [sheet];
    inside.append(...[...section.querySelectorAll("figure, p.told")].map((one) => document.adoptNode(one)));
    return panel(section.querySelector("h2").textContent, place);
  });
}
