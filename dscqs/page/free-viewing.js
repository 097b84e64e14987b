/** Variant I: the assessor changes between A and B as they like, and grades when they want to. */

import { freeButtons } from "./free-buttons.js";
import { frameAt } from "./schedule.js";

/**
 * Show until the assessor wants to grade, once both were seen: by keys, or by buttons over the
 * picture. Resolves with the log of what was shown when.
 */
export async function freeViewing({ presentation, sides, screen, environment, main, texts, title }) {
  const period = await environment.period();
  await Promise.all(Object.values(sides).map((side) => side.begin()));
  const surround = [presentation.grey, presentation.grey, presentation.grey];
  const log = {
    began: new Date().toISOString(),
    refresh_hz: 1000 / period,
    pixels: { A: sides.A.pixels, B: sides.B.pixels },
    intervals: [],
    faults: [],
  };
  return new Promise((resolve) => {
    let what = null;
    let entry = null;
    let index = null;
    let turn = 0;
    let isOver = false;
    const start = performance.now();
    const now = () => Math.round((performance.now() - start) * 1000) / 1000;
    const change = (next) => {
      if (next === what) return;
      if (entry) entry.to_ms = now();
      what = next;
      index = null;
      entry = { what, planned_ms: null, from_ms: now(), to_ms: null, frames: 0, late: 0, dropped: 0 };
      log.intervals.push(entry);
      bar.mark(what, mayGrade());
      sides[what].begin().catch((error) => fault({ kind: "decode", detail: error.message }));
    };
    const mayGrade = () => log.intervals.some((one) => one.what !== what);
    const finish = () => {
      if (isOver) return;
      isOver = true;
      entry.to_ms = now();
      stop();
      removeEventListener("keydown", press);
      bar.remove();
      for (const side of Object.values(sides)) side.rest();
      resolve(log);
    };
    const fault = ({ kind, detail }) => {
      log.faults.push({ kind, at_ms: now(), detail });
      finish();
    };
    const press = (event) => {
      const key = event.key.toLowerCase();
      if (event.target.closest?.("button") && [" ", "enter"].includes(key)) return;
      if (key === "a" || key === "b") change(key.toUpperCase());
      else if (key === " ") change(what === "A" ? "B" : "A");
      else if (key === "enter" && mayGrade()) finish();
      else return;
      event.preventDefault();
    };
    const draw = () => {
      if (isOver) return;
      const side = sides[what];
      const wanted = Number.isFinite(side.frameMs)
        ? frameAt(now() - entry.from_ms, side)
        : 0;
      turn = 1 - turn;
      if (wanted !== index || screen.isRedrawn) {
        const source = wanted === index ? side.current : side.prepare(wanted);
        if (source === null) entry.late += 1;
        else {
          if (wanted !== index) {
            entry.frames += 1;
            if (index !== null) entry.dropped += Math.abs(wanted - index) - 1;
          }
          index = wanted;
          screen.draw(source, surround, turn);
        }
      }
      screen.requestFrame(draw);
    };
    const stop = environment.watch(fault, { needsScreen: screen.needsScreen });
    addEventListener("keydown", press);
    const bar = freeButtons(main, texts, title, {
      A: () => change("A"), B: () => change("B"), grade: finish,
    });
    change("A");
    screen.requestFrame(draw);
  });
}
