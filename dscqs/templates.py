"""Plans from templates: the two sets of the thesis, over whatever contents there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dscqs.errors import PlanError
from dscqs.plan import Plan, plan_from_dict


@dataclass(frozen=True, kw_only=True)
class Template:
    """Which conditions are compared with which reference."""

    title: str
    reference: str
    conditions: tuple[str, ...]


TEMPLATES: Mapping[str, Template] = {
    "set1": Template(
        title="Set 1 of the thesis: degraded scenes whose original is known",
        reference="original",
        conditions=("bicubic", "sr"),
    ),
    "set2": Template(
        title="Set 2 of the thesis: real scenes of low resolution",
        reference="bicubic",
        conditions=("sr", "sr-calibration"),
    ),
}
"""By name. The reference of Set 1 is the original and that of Set 2 the bicubic interpolation;
the thesis' text names them the other way round in one place."""


def make_plan(
    stimuli: Mapping[str, Mapping[str, Any]],
    *,
    reference: str,
    conditions: Sequence[str],
    training: Sequence[str] = (),
    **fields: Any,
) -> Plan:
    """Return the plan of a test over every content that has all conditions.

    Parameters
    ----------
    stimuli : mapping
        ``file``, and where known ``sha256`` and ``pixels``, by ``content/condition``.
    reference, conditions : str, sequence of str
        What is compared with what.
    training : sequence of str
        Contents that are shown for training only, in every condition.
    fields
        Further fields of :class:`Plan`, as in a file.

    Raises
    ------
    PlanError
        If no content is complete, or a field is wrong.
    """
    wanted = (reference, *conditions)
    names = list(dict.fromkeys(key.split("/")[0] for key in stimuli))
    complete = [name for name in names if all(f"{name}/{one}" in stimuli for one in wanted)]
    for name in training:
        if name not in complete:
            raise PlanError(f"training: {name!r} is no content that has {', '.join(wanted)}")
    contents = [name for name in complete if name not in training]
    if not contents:
        found = ", ".join(stimuli) or "nothing"
        raise PlanError(f"contents: none has all of {', '.join(wanted)} (found: {found})")
    used = {
        f"{name}/{one}": stimuli[f"{name}/{one}"]
        for name in (*contents, *training)
        for one in wanted
    }
    return plan_from_dict(
        {
            "contents": contents,
            "conditions": list(conditions),
            "reference": reference,
            "training": [f"{name}/{one}" for name in training for one in conditions],
            "stimuli": {key: item["file"] for key, item in used.items()},
            "hashes": {key: item["sha256"] for key, item in used.items() if item.get("sha256")},
            "pixels": {key: item["pixels"] for key, item in used.items() if item.get("pixels")},
            **fields,
        }
    )
