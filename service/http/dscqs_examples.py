"""Examples for the description of the interface: one small test, from its folder to its exports."""

from __future__ import annotations

from typing import Any

from dscqs.displays import shipped_profiles
from dscqs.plan import Plan, plan_to_dict
from dscqs.templates import make_plan

FOLDER = "/srv/stimuli/set1"
TEST, SESSION = "t52e641c89319", "seed0479947dc690f"
CREATED, LAST = 1795676604.2510667, 1795676604.3268218
TICKET = "cqHvc8neQRd4nPGXZGcsS5XPl-GQ6zs0"
SUBMISSION = "add23057ff394fd1b1e3f56609ca7656"
LINK = "/dscqs/pages/enter.html#P5fdUPkrfkmuJiDcn9UXuK8ivnolz2bt"
DRY_RUN: dict[str, Any] = {
    "link": "/dscqs/pages/enter.html#dry-AixckkVv1B_jyVUQXauv9PudOvGSWi4l",
    "session": "s4601e8b183c3d1c1",
    "dry": True,
}
DIGESTS = {
    "ballet/original": "99bd404976b10b59adeb29d58e3109ee53edcf4f15f9461fa7b1ed1b23465891",
    "ballet/sr": "2f1e7dc926d6d7504c924b9b797636cc810e93d266b0157a39b6526cf0e105e9",
}

DISPLAYS: dict[str, dict[str, Any]] = {
    name: profile.as_dict() for name, profile in shipped_profiles().items()
}
DISPLAY = DISPLAYS["polarised"]
CALIBRATED = {
    **DISPLAYS["passive-monitor"],
    "pixel_pitch_mm": 0.276,
    "crosstalk": 0.02,
    "calibrated": "2026-11-26T09:40 UTC",
}

STIMULI: dict[str, Any] = {
    "folder": FOLDER,
    "label": "stimuli/set1",
    "kind": "still",
    "contents": ["ballet"],
    "conditions": ["original", "sr"],
}
WANTED: dict[str, Any] = {
    "folder": FOLDER,
    "template": "set1",
    "name": "Set 1",
    "training": [],
    "fields": {"conditions": ["sr"], "dummies": 0, "stages": []},
}
_PLAN: Plan = make_plan(
    {
        key: {"file": f"{key.replace('/', '--')}.png", "sha256": digest}
        for key, digest in DIGESTS.items()
    },
    reference="original", conditions=["sr"], folder=FOLDER, name="Set 1", dummies=0, stages=[],
)  # fmt: skip
PLAN = plan_to_dict(_PLAN)
LENGTH: dict[str, Any] = {
    "presentations": _PLAN.presentations,
    "minutes": round(_PLAN.session_s / 60, 1),
}
SUMMARY: dict[str, Any] = {
    "test": TEST, "name": "Set 1", "created": CREATED, "displays": ["polarised"], **LENGTH,
}  # fmt: skip

STATE: dict[str, Any] = {
    "stage": "presentation", "index": 0, "total": 1, "language": "en", "display": "polarised",
    "dimensions": ["quality"], "variant": "II", "showings": 2, "role": "station",
}  # fmt: skip
PRESENTATION: dict[str, Any] = {
    "ticket": TICKET,
    "kind": "still",
    "layout": "sbs",
    "sides": {
        "A": "/dscqs/api/assessor/stimulus/ShzQ8_IXqppFVdkEvkXC6TXleCSw5wMR",
        "B": "/dscqs/api/assessor/stimulus/x8gBVs1ypNaONn1x-2E-orCtv9iDJjd3",
    },
    "variant": "II",
    "grey": 128,
    "captions": True,
    "timing": PLAN["timing"],
    "dimensions": ["quality"],
    "labels": ["Excellent", "Good", "Fair", "Poor", "Bad"],
}
LOG: dict[str, Any] = {
    "began": "2026-11-26T10:05:00.000Z",
    "refresh_hz": 59.94,
    "pixels": {
        "A": "9ada56057a67763cc3623f8e7d41e1916af9c99828e57a1b8bfd5c38debcd9e6",
        "B": "882fe25e01f275e02b4ae0fd451a580dd45d6092e610a5e26acb0f1ffe8b9a8c",
    },
    "intervals": [
        {
            "what": "A", "planned_ms": 3000, "from_ms": 2002.0, "to_ms": 5005.0, "frames": 180,
            "late": 0, "dropped": 0,
        }
    ],
    "faults": [],
}  # fmt: skip
GRADES: dict[str, Any] = {"quality": {"A": 71.3, "B": 40.0}}

PROGRESS: dict[str, Any] = {
    "session": SESSION, "assessor": "a1", "display": "polarised", "language": "en",
    "role": "station", "group": None, "stage": "presentation", "step": "presentation",
    "index": 0, "total": 1, "failed": 1, "joined": True, "last": LAST,
    "notes": [{"at": LAST, "kind": "failed", "reason": "focus: the window lost the focus"}],
}  # fmt: skip

VOTES = f"""# test: Set 1 ({TEST})
# reference: original
# displays: ["polarised"]
# contents: ["ballet"]
# conditions: ["sr"]
# dimensions: ["quality"]
# grade_reference: grade of the reference; 0 = bad ... 100 = excellent, higher is better
# grade_test: grade of the tested condition; 0 = bad ... 100 = excellent, higher is better
# difference: grade_reference - grade_test, -100 ... 100; positive = the test is worse
assessor,display,content,condition,repetition,grade_reference,grade_test,difference,position,\
reference_side,graded_at,failed_showings,late_frames,dropped_frames
a1,polarised,ballet,sr,1,71.3,40.0,31.3,1,A,2026-11-26T07:03:24.326+00:00,0,0,0
"""
EVERYTHING: dict[str, Any] = {
    "test": TEST,
    "name": "Set 1",
    "created": "2026-11-26T07:03:24.251+00:00",
    "plan": PLAN,
    "files": {
        key: {"sha256": digest, "media_type": "image/png", "width": 64, "height": 24}
        for key, digest in DIGESTS.items()
    },
    "sessions": [
        {
            "session": SESSION, "assessor": "a1", "number": 0, "display": "polarised",
            "language": "en", "role": "station", "group": None,
            "created": "2026-11-26T07:03:24.295+00:00", "order_version": 1,
            "order": [
                {
                    "content": "ballet", "condition": "sr", "repetition": 0,
                    "reference_is_a": True, "kind": "test",
                }
            ],
            "forms": {},
            "events": [
                {"sequence": 1, "at": "2026-11-26T07:03:24.303+00:00", "name": "joined"},
                {
                    "sequence": 2, "at": "2026-11-26T07:03:24.311+00:00", "name": "offered",
                    "ticket": TICKET,
                },
                {
                    "sequence": 3, "at": "2026-11-26T07:03:24.321+00:00", "name": "shown",
                    "ticket": TICKET, "outcome": "ok", "log": LOG,
                },
                {
                    "sequence": 4, "at": "2026-11-26T07:03:24.326+00:00", "name": "graded",
                    "ticket": TICKET, "submission": SUBMISSION, "grades": GRADES,
                },
            ],
        }
    ],
}  # fmt: skip
SUREAL: dict[str, Any] = {
    "dataset_name": "Set 1",
    "notes": "os = grade of the stimulus, 0 = bad ... 100 = excellent, higher is better; "
    "display polarised; dimension quality",
    "ref_score": 100.0,
    "ref_videos": [{"content_id": 0, "content_name": "ballet", "path": "ballet/reference"}],
    "dis_videos": [
        {
            "content_id": 0, "asset_id": 0, "condition": "reference",
            "path": "ballet/reference", "os": {"a1": 71.3},
        },
        {
            "content_id": 0, "asset_id": 1, "condition": "sr", "path": "ballet/sr",
            "os": {"a1": 40.0},
        },
    ],
}  # fmt: skip
SUJSON: dict[str, Any] = {
    "dataset_name": "Set 1",
    "sujson_version": "1.1.1",
    "characteristics": {
        "per_subject_data": True, "method": "grades",
        "order": {
            "displays": ["polarised"], "contents": ["ballet"], "conditions": ["sr"],
            "dimensions": ["quality"],
        },
    },
    "tasks": [{"id": 1, "task": "Grade every presentation."}],
    "scales": [
        {
            "id": number, "name": name, "type": "continuous",
            "description": f"grade of the {what}; 0 = bad ... 100 = excellent, higher is better",
            "range": {"min": 0, "max": 100}, "labels": None,
        }
        for number, name, what in (
            (1, "grade_reference", "reference"), (2, "grade_test", "tested condition"),
        )
    ],
    "questions": [
        {
            "id": number, "question": f"quality: {name}", "scale_id": number,
            "characteristics": {"dimension": "quality", "figure": name},
        }
        for number, name in ((1, "grade_reference"), (2, "grade_test"))
    ],
    "src": [{"id": 1, "name": "ballet"}],
    "hrc": [{"id": 1, "name": "sr"}],
    "pvs": [{"id": 1, "src_id": 1, "hrc_id": 1}],
    "subjects": [{"id": 1, "name": "a1"}],
    "trials": [
        {
            "id": 1, "subject_id": 1, "task_id": 1, "pvs_id": 1, "score_id": [1, 2],
            "characteristics": {
                "display": "polarised", "repetition": 1, "dimension": "quality", "kind": "test",
                "extra": {
                    "position": "1", "reference_side": "A",
                    "graded_at": "2026-11-26T07:03:24.326+00:00", "failed_showings": "0",
                    "late_frames": "0", "dropped_frames": "0",
                },
            },
        }
    ],
    "scores": [
        {"id": 1, "question_id": 1, "score": 71.3, "pvs_id": 1},
        {"id": 2, "question_id": 2, "score": 40.0, "pvs_id": 1},
    ],
}  # fmt: skip


def _before_and_after(mean: float) -> dict[str, Any]:
    """Return a mean over one assessor, before and after screening."""
    alone = {
        "n": 1, "mean": mean, "sd": None, "se": None, "ci95_normal": None, "ci95_t": None,
    }  # fmt: skip
    return {"before": alone, "after": alone}


_FIGURES: dict[str, Any] = {
    **_before_and_after(31.3),
    "grade_reference": _before_and_after(71.3),
    "grade_test": _before_and_after(40.0),
    "test_score": _before_and_after(60.0),
    "reference_score": _before_and_after(28.7),
}
_SCREENED = {"P": 0, "Q": 0, "ratio_total": 0.0, "ratio_balance": None, "rejected": False}
_REPEATS = {
    "stimuli": 0, "mean_change": None, "within_sd": None, "repeatability": None,
    "correlation": None,
}  # fmt: skip
_STIMULUS = {"content": "ballet", "condition": "sr"}
SCORES: dict[str, Any] = {
    "format": "depthsr-dscqs-analysis/1",
    "votes": "Set 1",
    "dimension": "quality",
    "method": "grades",
    "figure": "difference",
    "direction": "difference = reference - test, -100 ... 100; positive: the test is worse",
    "informal": True,
    "assessors": {"polarised": 1},
    "stimuli": [{"display": "polarised", **_STIMULUS, **_FIGURES}],
    "pooled": [
        {
            "display": "polarised", "condition": "sr", **_FIGURES,
            "by_assessor": _before_and_after(31.3),
        }
    ],
    "screening": {
        "variant_used": "sample",
        "sample": {"polarised": {"rejected": [], "assessors": {"a1": _SCREENED}}},
        "population": {
            "polarised": {
                "rejected": ["a1"],
                "assessors": {
                    "a1": {
                        "P": 1, "Q": 1, "ratio_total": 2.0, "ratio_balance": 0.0,
                        "rejected": True,
                    }
                },
            }
        },
    },
    "missing": {
        "polarised": {"expected": 1, "given": 1, "by_assessor": {}, "by_stimulus": []}
    },
    "coherence": {
        "polarised": {
            "repeats": {"a1": _REPEATS},
            "all_repeats": _REPEATS,
            "agreement": {"a1": {"pearson": None, "spearman": None, "low": False}},
        }
    },
    "models": {
        "polarised": {
            "z_scores": [{**_STIMULUS, "z": None, "percent": None}],
            "bias_removal": {
                "bias": {"a1": 0.0},
                "stimuli": [{**_STIMULUS, "mean": 31.3}],
                "rejected": {"sample": [], "population": ["a1"]},
                "after": {"sample": [31.3], "population": [None]},
            },
            "maximum_likelihood": {
                "steps": 1, "converged": True, "dominated_by": None, "bias": {"a1": 0.0},
                "inconsistency": {"a1": 0.0},
                "stimuli": [
                    {**_STIMULUS, "quality": 31.3, "se_residual": 0.0, "se_model": 0.0001}
                ],
            },
        }
    },
    "comparisons": {
        "polarised": {
            "balanced": True, "complete": ["a1"], "incomplete": [], "anova": [],
            "friedman": None,
            "against_reference": [
                {
                    "first": "sr", "second": "reference", "n": 1, "mean": 31.3, "sd": None,
                    "ci95_t": None, "t": None, "df": None, "p": None, "p_holm": None,
                    "effect_size": None, "p_wilcoxon": None, "p_wilcoxon_holm": None,
                }
            ],
            "pairs": [],
        }
    },
    "anova_across_displays": {"assessors": [], "effects": []},
    "power": {"polarised": None},
}  # fmt: skip
