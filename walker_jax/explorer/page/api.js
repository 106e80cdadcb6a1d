// Requests to the server: the token, frames of a stream, and what to do when the server is gone.

const token = new URLSearchParams(location.search).get("token") ?? "";
const HEADERS = { "content-type": "application/json", "x-walker-token": token };
const WORDS = 0, CELLS = 1;
const PAUSE = 700; // ms between two looks whether the server is back

export class Refused extends Error {
  constructor(answer, status) {
    super(answer.error ?? `the server answered ${status}`);
    this.parameter = answer.parameter;
    this.status = status;
  }
}

export const connection = new EventTarget(); // "gone", "back", "other"
let gone = false;

async function send(path, body, signal) {
  const options = body === undefined ? { method: "GET" } : { method: "POST", body: JSON.stringify(body) };
  for (;;) {
    let answer;
    try {
      answer = await fetch(path, { ...options, headers: HEADERS, signal });
    } catch (error) {
      if (error.name !== "AbortError") lose();
      throw error;
    }
    if (answer.ok) return answer;
    if (answer.status !== 429 && answer.status !== 503) {
      const words = await answer.json().catch(() => ({}));
      throw new Refused(words, answer.status);
    }
    await wait(300 + 700 * Math.random(), signal); // too many at once: again, a little later
  }
}

export async function ask(path, body, signal) {
  return (await send(path, body, signal)).json();
}

export async function fetchBytes(path, body, signal) {
  return (await send(path, body, signal)).arrayBuffer();
}

/** The lines of an answer that grows, each of them JSON. */
export async function* lines(path, body, signal) {
  const reader = (await send(path, body, signal)).body.pipeThrough(new TextDecoderStream()).getReader();
  let held = "";
  for await (const text of pieces(reader)) {
    const whole = (held + text).split("\n");
    held = whole.pop();
    for (const line of whole) yield parsed(line);
  }
  if (held) yield parsed(held);
}

function parsed(line) {
  const found = JSON.parse(line);
  if (found.error) throw new Refused(found, 422);
  return found;
}

/** What a reader reads, until its end; the rest is given up. */
async function* pieces(reader) {
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      yield value;
    }
  } catch (error) {
    if (error.name !== "AbortError") lose();
    throw error;
  } finally {
    reader.cancel().catch(() => {});
  }
}

/** The frames of a picture as they come: {words} or {index, bytes}. */
export async function* frames(path, body, signal) {
  const reader = (await send(path, body, signal)).body.getReader();
  let held = new Uint8Array(0);
  for await (const bytes of pieces(reader)) {
    held = joined(held, bytes);
    let start = 0;
    while (held.length - start >= 5) {
      const view = new DataView(held.buffer, held.byteOffset + start);
      const length = view.getUint32(0, true), kind = view.getUint8(4);
      if (held.length - start < 5 + length) break;
      const content = held.slice(start + 5, start + 5 + length);
      start += 5 + length;
      if (kind === CELLS) {
        yield { index: new DataView(content.buffer).getUint32(0, true), bytes: content.subarray(4) };
      } else {
        const words = JSON.parse(new TextDecoder().decode(content));
        if (kind !== WORDS) throw new Refused(words, 422);
        yield { words };
      }
    }
    held = held.slice(start);
  }
}

function joined(a, b) {
  if (a.length === 0) return b;
  const both = new Uint8Array(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}

function wait(time, signal) {
  return new Promise((done, fail) => {
    setTimeout(done, time);
    signal?.addEventListener("abort", () => fail(new DOMException("given up", "AbortError")));
  });
}

/** Say that the server is gone, and look until it is back. */
async function lose() {
  if (gone) return;
  gone = true;
  connection.dispatchEvent(new Event("gone"));
  for (;;) {
    await wait(PAUSE);
    const answer = await fetch("/api/alive", { headers: HEADERS }).catch(() => null);
    if (answer === null) continue;
    if (answer.status === 403) connection.dispatchEvent(new Event("other")); // of another token
    if (!answer.ok) continue; // too busy, perhaps
    gone = false;
    return connection.dispatchEvent(new Event("back"));
  }
}
