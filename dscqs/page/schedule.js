/** When what is shown: pure functions. */

/** An interval may always be off by some refreshes: they cannot be divided. */
const TOLERATED_REFRESHES = 2;

/**
 * Return the intervals of a presentation of variant II: [{what, caption, ms}].
 *
 * What is "grey", "A" or "B". A grey comes before each side, with its letter where captions are
 * wanted, so that letters never lie on pictures; the vote follows the last side at once.
 */
export function makeSchedule({ timing, captions }) {
  const intervals = [];
  for (let showing = 0; showing < timing.showings; showing++) {
    for (const side of ["A", "B"]) {
      if (timing.grey_s > 0) {
        intervals.push({
          what: "grey",
          caption: captions ? side : null,
          ms: 1000 * timing.grey_s,
        });
      }
      intervals.push({ what: side, caption: null, ms: 1000 * timing.show_s });
    }
  }
  return intervals;
}

/** Return which frame of a clip to show after some time; short clips run to and fro, or rest. */
export function frameAt(elapsedMs, { count, frameMs, isWhole }) {
  const index = Math.floor(elapsedMs / frameMs + 1e-6);
  if (index < count) return index;
  if (!isWhole || count === 1) return count - 1;
  const place = index % (2 * count - 2);
  return place < count ? place : 2 * count - 2 - place;
}

/** Return whether an interval that should have lasted `planned` lasted too long or too short. */
export function isOff(planned, lasted, { toleranceMs, periodMs }) {
  const most = Math.max(toleranceMs, TOLERATED_REFRESHES * periodMs);
  return Math.abs(lasted - planned) > most + 1e-6;
}
