// A page that stays true: it is drawn again when its rotor has news, and says when it is out of date.

import { Problem, forgetKey, get, headers, key, path, typeKey } from "./api.js";
import { $ } from "./dom.js";
import { failed, notices } from "./states.js";

const AWAY = "away";
const AGAIN_MS = 30_000;
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** Until the page is hidden or shown. */
const turned = () =>
  new Promise((done) => document.addEventListener("visibilitychange", done, { once: true }));

/** The state of the page's connection, in the top bar. */
export function told(text) {
  const place = $("live");
  if (place.textContent !== text) place.textContent = text;
}

/** Events of a text/event-stream body: {id, event, data}. */
async function* frames(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    const parts = text.split("\n\n");
    text = parts.pop();
    for (const part of parts) {
      const frame = { id: null, event: null, data: null };
      for (const line of part.split("\n")) {
        const at = line.indexOf(": ");
        if (at > 0 && line.slice(0, at) in frame) frame[line.slice(0, at)] = line.slice(at + 2);
      }
      if (frame.event) yield frame;
    }
  }
}

/** The version that the page shows: an event that tells of it is no news. */
export const drawn = { version: -1 };

/** Where a rotor's log and posterior stand, as text; null: it did not answer. */
async function stands(rotor) {
  const now = await get(path`/v1/rotors/${rotor}`).catch(() => null);
  return now && JSON.stringify([now.head_seq, now.applied_seq, now.version, now.health]);
}

/**
 * Follow a rotor's events: `news(event, data)` for each; goes on after the last one when the
 * connection was lost. (EventSource cannot send a key; the stream is the same.) A page that nobody
 * looks at lets its stream go: a browser has six connections to a server, for all of its tabs. What
 * no event tells of (entries that no worker takes) is looked for now and then: `news("changed")`.
 */
export async function follow(rotor, news) {
  let last = null;
  let wait = 500;
  let known = await stands(rotor);
  setInterval(async () => {
    if (document.hidden) return;
    const now = await stands(rotor);
    if (now !== null && known !== null && now !== known) news("changed", {});
    known = now ?? known;
  }, AGAIN_MS);
  for (;;) {
    while (document.hidden) await turned();
    const stop = new AbortController();
    const hide = () => document.hidden && stop.abort();
    document.addEventListener("visibilitychange", hide);
    try {
      const more = last === null ? {} : { "Last-Event-ID": last };
      const sent = { headers: headers(more), signal: stop.signal };
      const answer = await fetch(path`/v1/rotors/${rotor}/events`, sent);
      if (answer.status === 404) return;
      if (!answer.ok) throw new Problem(answer.status, "", "");
      told("live");
      wait = 500;
      for await (const frame of frames(answer.body)) {
        last = frame.id ?? last;
        const data = JSON.parse(frame.data);
        if (frame.event !== "applied" || data.version > drawn.version) news(frame.event, data);
      }
    } catch (error) {
      if (!(error instanceof TypeError || error instanceof Problem || error.name === "AbortError")) throw error;
    } finally {
      document.removeEventListener("visibilitychange", hide);
    }
    told("not live: connecting");
    await pause(wait);
    wait = Math.min(2 * wait, 10_000);
    news("reconnect", {});
  }
}

/** Whether an answer is another than the last one: what is read by the clock is drawn where it changed. */
export function changes() {
  let last = null;
  return (answer) => {
    const text = JSON.stringify(answer);
    const news = text !== last;
    last = text;
    return news;
  };
}

/**
 * Draw a page, and again when asked: never twice at once, and once more where news came meanwhile.
 * `draw` reads and shows; what it throws is told above the page, which keeps what it had.
 */
export function keep(draw, { everyS = 0 } = {}) {
  let busy = false;
  let again = false;
  let shown = false;
  let retry = 0;
  let was = null; // what the top bar said before the service was away
  const redraw = async () => {
    clearTimeout(retry);
    if (busy) {
      again = true;
      return;
    }
    busy = true;
    try {
      do {
        again = false;
        await draw();
        shown = true;
        $("page").style.visibility = "";
        if (was !== null && $("live").textContent === AWAY) told(was);
        was = null;
        document.body.dataset.state = "ready";
      } while (again);
    } catch (error) {
      if (error.name === "AbortError") return;
      if (!(error instanceof Problem)) {
        notices([["bad", "This page failed.", String(error)]]);
        console.error(error);
      } else {
        const [kind, title, detail] = failed(error);
        notices([[kind, title, detail, shown ? "What is shown below is what was known before." : null]]);
        if (error.status === 0) {
          was ??= $("live").textContent;
          told(AWAY);
        }
      }
      if (!shown) $("page").style.visibility = "hidden"; // what is drawn later is drawn into it
      document.body.dataset.state = "failed";
      const passing = error.status === 0 || error.status === 409 || error.status >= 500 || error.status === 429;
      if (passing) retry = setTimeout(redraw, error.status === 429 ? 5000 : 2000);
    } finally {
      busy = false;
    }
  };
  if (everyS) {
    setInterval(() => {
      if (!document.hidden) redraw();
    }, 1000 * everyS);
    told(`every ${everyS} s`);
  }
  $("key").textContent = key() ? "Forget key" : "Key";
  $("key").addEventListener("click", async () => {
    if (key()) forgetKey();
    else if (!(await typeKey("Give a key."))) return;
    location.reload();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  redraw();
  return redraw;
}
