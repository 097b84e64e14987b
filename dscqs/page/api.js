/** Talks to the server: JSON, patient with a network that fails, plain with everything else. */

import { fromBase64, sha256 } from "./sha256.js";

const BASE = "/dscqs/api/assessor/";
const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 15_000;
/** Answers of proxies and of a server that starts or stops: worth another try. */
const PASSING = new Set([502, 503, 504]);

/** An answer that is no success. */
export class ApiError extends Error {
  constructor(status, code, message) {
    super(message);
    this.status = status;
    this.code = code;
  }
}

/** `onTrouble(true)` when the server cannot be reached, `onTrouble(false)` when it can again. */
export class Api {
  constructor(onTrouble = () => {}, base = BASE) {
    this.onTrouble = onTrouble;
    this.base = base;
  }

  get(path) {
    return this.#json(path, {});
  }

  post(path, body) {
    return this.#json(path, this.#sending("POST", body));
  }

  put(path, body) {
    return this.#json(path, this.#sending("PUT", body));
  }

  /** Add to the audit trail; nobody waits for it. `detail` is an object. */
  note(kind, detail = {}) {
    const asked = { ...this.#sending("POST", { kind, detail }), keepalive: true };
    fetch(this.base + "events", asked).catch(() => {});
  }

  /**
   * Return the bytes under an address that works once, checked against their digest.
   *
   * @throws ApiError where the address is used up or the bytes are not those that were sent
   */
  async bytes(url) {
    const answer = await fetch(url);
    if (!answer.ok) throw new ApiError(answer.status, "stimulus", `the stimulus is not there`);
    const bytes = new Uint8Array(await answer.arrayBuffer());
    const said = /sha-256=:([^:]+):/.exec(answer.headers.get("Repr-Digest") ?? "");
    if (said === null) throw new ApiError(0, "bytes", "the stimulus came without a digest");
    const wanted = fromBase64(said[1]);
    const found = await sha256(bytes);
    if (!found.every((byte, index) => byte === wanted[index])) {
      throw new ApiError(0, "bytes", "the stimulus was changed on its way");
    }
    return { bytes, type: answer.headers.get("Content-Type") };
  }

  #sending(method, body) {
    return {
      method,
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify(body),
    };
  }

  async #json(path, options) {
    let isInTrouble = false;
    for (let pause = FIRST_PAUSE_MS; ; pause = Math.min(2 * pause, LONGEST_PAUSE_MS)) {
      try {
        const answer = await fetch(this.base + path, options);
        if (!PASSING.has(answer.status)) {
          if (isInTrouble) this.onTrouble(false);
          return await read(answer);
        }
      } catch (error) {
        if (error instanceof ApiError) throw error;
      }
      isInTrouble = true;
      this.onTrouble(true);
      await online(pause);
    }
  }
}

async function read(answer) {
  const text = await answer.text();
  let body = null;
  try {
    body = text === "" ? null : JSON.parse(text);
  } catch {
    body = null;
  }
  if (answer.ok) return body;
  throw new ApiError(answer.status, body?.code ?? "", body?.message ?? `status ${answer.status}`);
}

/** Wait, but no longer than until the browser says that it is online again. */
function online(ms) {
  return new Promise((resolve) => {
    const done = () => {
      clearTimeout(timer);
      removeEventListener("online", done);
      resolve();
    };
    const timer = setTimeout(done, ms);
    addEventListener("online", done);
  });
}
