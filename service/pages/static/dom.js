// Elements. What comes from the service becomes text nodes and attributes, never markup.

const SVG = "http://www.w3.org/2000/svg";

function fill(element, given, children) {
  for (const [name, value] of Object.entries(given)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.flat(3).filter((one) => one !== null && one !== undefined));
  return element;
}

/** An element: h("a", {href, class, onclick}, children …). */
export const h = (tag, given = {}, ...children) =>
  fill(document.createElement(tag), given, children);
/** An element of a picture. */
export const s = (tag, given = {}, ...children) =>
  fill(document.createElementNS(SVG, tag), given, children);

let pen = null;
/** A name as wide as there is room, px; of a longer one its end, by which serial numbers differ. */
export function within(name, room, size = 12) {
  pen ??= document.createElement("canvas").getContext("2d");
  pen.font = `${size}px system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif`;
  const fits = (text) => pen.measureText(text).width <= room;
  const signs = [...String(name)];
  if (fits(String(name))) return String(name);
  while (signs.length && !fits(`…${signs.join("")}`)) signs.shift();
  return signs.length ? `…${signs.join("")}` : "";
}

export const $ = (id) => document.getElementById(id);
export const names = document.body.dataset;

/** New children in a place. What was open stays open, scrolled stays scrolled, and the keyboard stays where it was. */
export function show(place, ...children) {
  const left = held(place);
  place.replaceChildren(...children.flat(3).filter((one) => one !== null && one !== undefined));
  left();
}

const INSIDE = "details[open], .scroll, a, button, input, select, summary, [tabindex]";
const called = (one) => `${one.tagName} ${one.getAttribute("href") ?? one.getAttribute("aria-label") ?? (one.matches("details") ? one.firstElementChild : one.closest("label") ?? one).textContent}`;

/** What people did to a place, by the names of its elements; a function that does it again. */
function held(place) {
  const active = place.contains(document.activeElement) && document.activeElement !== place ? document.activeElement : null;
  const found = [];
  const count = {};
  for (const one of place.querySelectorAll(INSIDE)) {
    const name = called(one);
    count[name] = (count[name] ?? -1) + 1;
    const [top, left] = [one.scrollTop, one.scrollLeft];
    if (one.open || one === active || top || left) found.push({ name, nth: count[name], open: one.open, focus: one === active, top, left });
  }
  return () => {
    for (const was of found) {
      const [tag] = was.name.split(" ", 1);
      const one = [...place.querySelectorAll(tag)].filter((each) => called(each) === was.name)[was.nth];
      if (!one) continue;
      if (was.open) one.open = true;
      if (was.top || was.left) one.scrollTo(was.left, was.top);
      if (was.focus && document.activeElement !== one) one.focus({ preventScroll: true });
    }
  };
}

export const panel = (title, ...children) =>
  h("section", { class: "panel" }, title ? h("h2", {}, title) : null, ...children);

export const facts = (pairs) =>
  h("dl", { class: "facts" }, pairs.filter(Boolean).map(([what, value]) => [h("dt", {}, what), h("dd", {}, value)]));

/** A closed part that opens: the table beside a chart. */
export const aside = (title, ...children) => h("details", {}, h("summary", {}, title), ...children);

/**
 * A table. Columns: {name, value: row => text or element, sort?: row => number or string, number?,
 * called?: its cells are names that people gave, of any length}.
 * With `sort` on a column its head is a button. Options: caption, sorted: [index, up], rowClass.
 */
export function table(columns, rows, { caption = null, sorted = null, rowClass = null, label = null } = {}) {
  let [by, up] = sorted ?? [null, true];
  const body = h("tbody");
  const heads = columns.map((column, i) => {
    const name = column.sort
      ? h("button", { type: "button", onclick: () => turn(i) }, column.name)
      : column.name;
    return h("th", { scope: "col", class: column.number ? "number" : null }, name);
  });
  const draw = () => {
    const order = [...rows];
    if (by !== null) {
      const of = columns[by].sort;
      order.sort((a, b) => compare(of(a), of(b)) * (up ? 1 : -1));
    }
    heads.forEach((head, i) => {
      if (!columns[i].sort) return;
      head.setAttribute("aria-sort", i === by ? (up ? "ascending" : "descending") : "none");
    });
    show(body, order.map((row) => h("tr", { class: rowClass?.(row) }, columns.map((column) =>
      h("td", { class: column.number ? "number" : column.called ? "called" : null }, column.value(row))))));
  };
  const turn = (i) => {
    up = i === by ? !up : true;
    by = i;
    draw();
    made.dispatchEvent(new CustomEvent("sorted", { detail: [by, up] }));
  };
  const made = h("table", { "aria-label": label }, caption ? h("caption", {}, caption) : null, h("thead", {}, h("tr", {}, heads)), body);
  draw();
  return made;
}

/** Numbers by size, texts as people count (B2 before B10), what is missing last. */
function compare(a, b) {
  const gone = (v) => v === null || v === undefined || Number.isNaN(v);
  if (gone(a) || gone(b)) return gone(a) - gone(b);
  if (typeof a === "number" && typeof b === "number") return a - b;
  return String(a).localeCompare(String(b), "en", { numeric: true });
}

export const scroll = (label, ...children) =>
  h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": label }, ...children);

/** A picture that is wider than a small screen. */
export const across = (label, picture) => {
  const made = scroll(label, picture);
  made.classList.add("across");
  return made;
};

export const option = (value, text, selected) =>
  h("option", { value, selected: selected ? true : null }, text);

export const select = (label, values, chosen, change) =>
  h("label", {}, label, h("select", { onchange: (event) => change(event.target.value) },
    values.map(([value, text]) => option(value, text, String(value) === String(chosen)))));

/** The value of a name in the page's query, and a change of it without a new page. */
export const asked = (name) => new URLSearchParams(location.search).get(name);
export function remember(given) {
  const params = new URLSearchParams(location.search);
  for (const [name, value] of Object.entries(given)) {
    if (value === null || value === "") params.delete(name);
    else params.set(name, value);
  }
  const text = params.toString();
  history.replaceState(null, "", text ? `?${text}` : location.pathname);
}

/** A colour of the sheet. */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
