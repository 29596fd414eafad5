// The public API as the pages read it. A key that was typed is kept for this tab alone.

const KEPT = "bladetwin.key";

/** What went wrong, as a problem (RFC 9457) tells it; status 0: the service does not answer. */
export class Problem extends Error {
  constructor(status, kind, detail) {
    super(detail);
    this.status = status;
    this.kind = kind;
  }
}

export const key = () => sessionStorage.getItem(KEPT);

/** A path with its query; names are escaped: path`/v1/rotors/${r}`. */
export function path(parts, ...names) {
  return parts.reduce((text, part, i) => text + encodeURIComponent(names[i - 1]) + part);
}

export function query(given) {
  const kept = Object.entries(given).filter(([, v]) => v !== null && v !== undefined && v !== "");
  const text = new URLSearchParams(kept.map(([k, v]) => [k, String(v)])).toString();
  return text ? `?${text}` : "";
}

export function headers(more = {}) {
  return key() ? { Authorization: `Bearer ${key()}`, ...more } : more;
}

async function problemOf(answer) {
  const told = await answer.json().catch(() => ({}));
  const kind = String(told.type || "").split(":").pop() || `http-${answer.status}`;
  return new Problem(answer.status, kind, told.detail || `the service answered ${answer.status}`);
}

/** The raw answer; asks for a key where one is needed, throws Problem for every refusal. */
export async function ask(method, url, body, signal) {
  const type = body === undefined ? {} : { "Content-Type": "application/json" };
  const sent = { method, headers: headers(type), signal };
  if (body !== undefined) sent.body = JSON.stringify(body);
  let answer;
  try {
    answer = await fetch(url, sent);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, "away", "the service does not answer; this page tries again by itself.");
  }
  if (answer.status === 401) {
    const why = key() ? "This key is not accepted." : "This service answers those with a key.";
    if (!declined && (await typeKey(why))) return ask(method, url, body, signal);
    declined = true; // a page that reads by the clock would ask by the clock
    throw new Problem(401, "key-required", `${why} “Key” above asks for it again.`);
  }
  if (!answer.ok) throw await problemOf(answer);
  return answer;
}

let most = Infinity;

/** A JSON answer. A page size above this service's maximum is asked for again at the maximum. */
export async function get(url, given = {}, signal) {
  const sent = given.limit > most ? { ...given, limit: most } : given;
  try {
    return await (await ask("GET", url + query(sent), undefined, signal)).json();
  } catch (error) {
    const above = error instanceof Problem && error.message.match(/^limit = \d+ is above (\d+)/);
    if (!above || Number(above[1]) >= most) throw error;
    most = Number(above[1]);
    return get(url, given, signal);
  }
}
export const post = async (url, body = {}) => (await ask("POST", url, body)).json();
export const remove = async (url) => (await ask("DELETE", url)).json();

/** Every page of a list, up to a number of items; `more` says that there are further ones. */
export async function pages(url, given = {}, enough = 1000) {
  const items = [];
  let cursor = given.cursor ?? null;
  do {
    const page = await get(url, { limit: 200, ...given, cursor });
    items.push(...page.items);
    cursor = page.next;
  } while (cursor !== null && items.length < enough);
  return { items, more: cursor !== null };
}

let routes = null;

/** Whether the API has a route, e.g. offers("post", "/v1/rotors/{r}/retry"). */
export async function offers(method, template) {
  routes ??= get("/openapi.json").then((document) => document.paths).catch((error) => {
    routes = null; // asked again the next time
    throw error;
  });
  return Boolean((await routes)[template]?.[method]);
}

let asking = null;
let declined = false;

/** Ask for a key once, however many requests need it; resolves with whether one was typed. */
export function typeKey(why) {
  asking ??= new Promise((typed) => {
    const dialog = document.createElement("dialog");
    const form = document.createElement("form");
    const label = document.createElement("label");
    const input = document.createElement("input");
    const said = document.createElement("p");
    const use = document.createElement("button");
    const not = document.createElement("button");
    form.method = "dialog";
    said.textContent = `${why} It is kept until this tab is closed, and sent to this server alone.`;
    label.htmlFor = input.id = "typed-key";
    label.textContent = "API key";
    input.type = "password";
    input.autocomplete = "off";
    input.required = true;
    use.textContent = "Use it";
    use.value = "typed";
    use.className = "main";
    not.type = "button";
    not.textContent = "Cancel";
    not.addEventListener("click", () => dialog.close());
    form.append(said, label, input, use, " ", not);
    dialog.append(form);
    dialog.setAttribute("aria-label", "API key");
    dialog.addEventListener("close", () => {
      const given = dialog.returnValue === "typed";
      if (given) sessionStorage.setItem(KEPT, input.value.trim());
      declined &&= !given;
      dialog.remove();
      asking = null;
      typed(given);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
  return asking;
}

export function forgetKey() {
  sessionStorage.removeItem(KEPT);
}
