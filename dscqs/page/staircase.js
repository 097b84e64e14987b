/** Which level comes next in a test of descending levels: a pure state machine. */

/** Answers asked for at each level, and those of them that must be right. */
export const TRIALS = 3;
export const NEEDED = 3;

/** Begin at the first level that can be shown; `levels` are [{value, isShown}], easiest first. */
export function begin(levels) {
  return advance({ levels, at: -1, results: [], isOver: false });
}

/** Return the state after an answer. */
export function answer(state, isRight) {
  const results = state.results.slice();
  const last = { ...results[results.length - 1] };
  last.trials += 1;
  last.right += isRight ? 1 : 0;
  results[results.length - 1] = last;
  const changed = { ...state, results };
  const wrong = last.trials - last.right;
  if (wrong > TRIALS - NEEDED) return { ...changed, isOver: true };
  return last.right >= NEEDED ? advance(changed) : changed;
}

/** Return the finest level passed, or null. */
export function threshold(state) {
  const passed = state.results.filter((result) => result.right >= NEEDED);
  return passed.length === 0 ? null : passed[passed.length - 1].value;
}

function advance(state) {
  const at = state.levels.findIndex((level, index) => index > state.at && level.isShown);
  if (at < 0) return { ...state, isOver: true };
  const results = [...state.results, { value: state.levels[at].value, trials: 0, right: 0 }];
  return { ...state, at, results };
}
