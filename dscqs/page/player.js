/** Shows the two sides of a presentation to the clock of the screen, and tells how it went. */

import { frameAt, isOff, makeSchedule } from "./schedule.js";

/**
 * What shows and asks for frames: the page's canvas, or a headset.
 *
 * draw(source, surround, turn); requestFrame(callback of a time in ms)
 */
export function canvasScreen(drawing) {
  return {
    needsScreen: true,
    isRedrawn: drawing.profile.mode === "frame-sequential",
    draw: (source, surround, turn) => drawing.draw(source, surround, turn),
    requestFrame: (callback) => requestAnimationFrame(callback),
  };
}

/** The same for a headset that has begun. */
export function headsetScreen(headset) {
  return {
    needsScreen: false,
    isRedrawn: true,
    draw: (source, surround) => headset.draw(source, surround),
    requestFrame: (callback) => headset.requestFrame(callback),
  };
}

/**
 * Play a presentation; resolves with its log (docs/dscqs-api.md), whose `faults` are empty where
 * everything was shown as planned. Ends at the first fault.
 *
 * @param presentation as the server gives it
 * @param sides {A, B}: stimuli that are ready
 * @param letters {A, B}: sources of the captions
 * @param screen of `canvasScreen` or `headsetScreen`
 * @param environment watches for disturbances
 */
export async function play({ presentation, sides, letters, screen, environment }) {
  const period = await environment.period();
  await sides.A.begin();
  const run = new Run(presentation, sides, letters, screen, period);
  const stop = environment.watch((fault) => run.fault(fault), { needsScreen: screen.needsScreen });
  try {
    return await run.done;
  } finally {
    stop();
    screen.requestFrame(() => screen.draw(null, run.surround, 0));
  }
}

class Run {
  #schedule;
  #ends;
  #at = -1;
  #shown = null;
  #turn = 0;
  #start = null;
  #last = null;
  #isOver = false;

  constructor(presentation, sides, letters, screen, period) {
    this.#schedule = makeSchedule(presentation);
    let end = 0;
    this.#ends = this.#schedule.map((interval) => (end += interval.ms));
    this.sides = sides;
    this.letters = letters;
    this.screen = screen;
    this.period = period;
    this.tolerated = { toleranceMs: 1000 * presentation.timing.tolerance_s, periodMs: period };
    this.surround = [presentation.grey, presentation.grey, presentation.grey];
    this.log = {
      began: new Date().toISOString(),
      refresh_hz: 1000 / period,
      pixels: { A: sides.A.pixels, B: sides.B.pixels },
      intervals: [],
      faults: [],
    };
    this.done = new Promise((resolve) => {
      this.resolve = resolve;
    });
    screen.requestFrame((now) => this.#frame(now));
  }

  /** Note what went wrong, and end. */
  fault({ kind, detail }) {
    if (this.#isOver) return;
    const at = this.#start === null ? 0 : performance.now() - this.#start;
    this.log.faults.push({ kind, at_ms: rounded(at), detail });
    this.#end();
  }

  #frame(now) {
    if (this.#isOver) return;
    this.#start ??= now;
    const elapsed = now - this.#start;
    const gap = this.#last === null ? 0 : now - this.#last;
    this.#last = now;
    const missed = Math.max(0, Math.round(gap / this.period) - 1);
    if (this.#at >= 0) this.log.intervals[this.#at].late += missed;
    if (this.#isMoving() && isOff(this.period, gap, this.tolerated)) {
      this.fault({ kind: "stall", detail: `no refresh for ${gap.toFixed(0)} ms` });
      return;
    }
    while (this.#at < 0 || elapsed >= this.#ends[this.#at] - this.period / 2) {
      if (!this.#leave(elapsed)) return;
    }
    this.#show(elapsed);
    if (!this.#isOver) this.screen.requestFrame((time) => this.#frame(time));
  }

  /** Tell whether a video is on the screen: a still does not suffer from a refresh missed. */
  #isMoving() {
    return this.#at >= 0 && this.sides[this.#schedule[this.#at].what]?.count > 1;
  }

  /** Go on to the next interval; false where the presentation is over. */
  #leave(elapsed) {
    const past = this.log.intervals[this.#at];
    if (past !== undefined) {
      past.to_ms = rounded(elapsed);
      if (past.frames === 0) {
        this.fault({ kind: "stall", detail: `${past.what} was not shown at all` });
        return false;
      }
      const lasted = past.to_ms - past.from_ms;
      if (isOff(past.planned_ms, lasted, this.tolerated)) {
        this.fault({ kind: "late", detail: `${past.what} lasted ${lasted.toFixed(1)} ms` });
        return false;
      }
    }
    this.#at += 1;
    if (this.#at === this.#schedule.length) {
      this.#end();
      return false;
    }
    const { what, ms } = this.#schedule[this.#at];
    this.log.intervals.push({
      what, planned_ms: ms, from_ms: rounded(elapsed), to_ms: null, frames: 0, late: 0, dropped: 0,
    });
    this.#shown = null;
    this.#prepare(this.#schedule[this.#at + 1]);
    return true;
  }

  /** Let the next side get ready while something else is on the screen. */
  #prepare(interval) {
    const side = this.sides[interval?.what];
    side?.begin().catch((error) => this.fault({ kind: "decode", detail: error.message }));
  }

  #show(elapsed) {
    const { what, caption } = this.#schedule[this.#at];
    const entry = this.log.intervals[this.#at];
    this.#turn = 1 - this.#turn;
    if (what === "grey") {
      const source = caption === null ? null : this.letters[caption];
      this.#draw(what, source, entry);
      return;
    }
    const side = this.sides[what];
    const index = frameAt(elapsed - entry.from_ms + this.period / 2, side);
    if (index !== this.#shown) {
      const step = this.#shown === null ? index : Math.abs(index - this.#shown) - 1;
      entry.dropped += step;
      if (step > 0) {
        this.fault({ kind: "dropped", detail: `${step} frame(s) before frame ${index} of ${what}` });
        return;
      }
    }
    const source = index === this.#shown ? side.current : side.prepare(index);
    if (source === null) {
      this.fault({ kind: "late", detail: `frame ${index} of ${what} was not decoded in time` });
      return;
    }
    this.#draw(index, source, entry);
  }

  #draw(shown, source, entry) {
    if (shown === this.#shown && !this.screen.isRedrawn) return;
    if (shown !== this.#shown) entry.frames += 1;
    this.#shown = shown;
    this.screen.draw(source, this.surround, this.#turn);
  }

  #end() {
    this.#isOver = true;
    for (const side of Object.values(this.sides)) side.rest();
    this.resolve(this.log);
  }
}

function rounded(ms) {
  return Math.round(ms * 1000) / 1000;
}
