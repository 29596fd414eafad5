// A page that stays true: it is drawn again when its rotor has news, and says when it is out of date.

import { Problem, forgetKey, headers, key, path, typeKey } from "./api.js";
import { $, show } from "./dom.js";
import { failed, notices } from "./states.js";

const pause = (ms) => new Promise((done) => setTimeout(done, ms));

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

/**
 * Follow a rotor's events: `news(event, data)` for each; goes on after the last one when the
 * connection was lost. (EventSource cannot send a key; the stream is the same.)
 */
export async function follow(rotor, news) {
  let last = null;
  let wait = 500;
  for (;;) {
    try {
      const more = last === null ? {} : { "Last-Event-ID": last };
      const answer = await fetch(path`/v1/rotors/${rotor}/events`, { headers: headers(more) });
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
    }
    told("not live: connecting");
    await pause(wait);
    wait = Math.min(2 * wait, 10_000);
    news("reconnect", {});
  }
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
        if (error.status === 0) told("away");
      }
      if (!shown) show($("page"));
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
    else await typeKey("Give a key.");
    location.reload();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  redraw();
  return redraw;
}
