/** What the report of a job says, in words and plots. */

import { element } from "./api.js";
import { plot } from "./plot.js";

const percent = (share) => (Number.isFinite(share) ? `${(100 * share).toFixed(1)} %` : "–");
const mean = (values) => {
  const good = values.filter(Number.isFinite);
  return good.reduce((a, b) => a + b, 0) / good.length;
};

/** Return the plots of a report. */
export function plotsOf(report) {
  const frames = report.frames ?? [];
  if (frames.length < 2) return [];
  const of = (pick) => frames.map((frame) => [frame.frame_index, pick(frame)]);
  const targets = frames[0].targets.map(({ view_id: id }) => id).slice(0, 2);
  const trusted = (frame, id) => {
    const target = frame.targets.find(({ view_id: other }) => other === id);
    return target ? 100 * mean(target.views.map((view) => view.verified_fraction)) : NaN;
  };
  return [
    plot("Time of a frame", "s", [{ label: "all stages", values: of((frame) => frame.timings.frame) }]),
    plot("Pixels that are trusted", "%",
      targets.map((id) => ({ label: id, values: of((frame) => trusted(frame, id)) }))),
    plot("Noise of the input", "grey levels", [{ label: "σ", values: of((frame) => frame.noise_sigma) }]),
  ];
}

/** Return table rows: what each view brought to each eye, mean over the frames. */
export function viewRows(report) {
  const rows = new Map();
  for (const frame of report.frames ?? []) {
    for (const target of frame.targets) {
      for (const view of target.views) {
        const key = `${target.view_id}\n${view.view_id}`;
        if (!rows.has(key)) rows.set(key, []);
        rows.get(key).push(view);
      }
    }
  }
  return [...rows].map(([key, views]) => {
    const [eye, view] = key.split("\n");
    const of = (name) => mean(views.map((item) => item[name]));
    const number = (text) => element("td", { class: "number" }, text);
    const rms = of("residual_rms");
    return element("tr", {}, element("td", {}, eye), element("td", {}, view),
      number(percent(of("registered_fraction"))), number(percent(of("verified_fraction"))),
      number(percent(of("weight_fraction"))), number(Number.isFinite(rms) ? rms.toFixed(2) : "–"));
  });
}

/** Return what is worth knowing of one frame, as [name, value]. */
export function frameFacts(report, frameIndex) {
  const frame = report.frames?.find(({ frame_index: index }) => index === frameIndex);
  if (!frame) return [];
  const facts = [
    ["frame", frame.frame_index],
    ["computed in", `${frame.timings.frame?.toFixed(2) ?? "–"} s`],
    ["noise", `${frame.noise_sigma.toFixed(2)} grey levels`],
    ["PSF", `σ ${frame.psf_sigma.toFixed(2)}, ${frame.psf_support} px`],
  ];
  for (const target of frame.targets) {
    facts.push([`trusted, ${target.view_id}`,
      percent(mean(target.views.map((view) => view.verified_fraction)))]);
    facts.push([`solver, ${target.view_id}`, `${target.solver}, ${target.iterations} iterations`]);
  }
  return facts;
}
