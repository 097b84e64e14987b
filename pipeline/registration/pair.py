"""One view registered onto one reference: from scratch, or from how it was in the previous frame.

Patches (Eq. 1), their motions (Eq. 2), the landing point of every pixel, registration weights
(Eq. 3) and verification (Eq. 4) of two views. Which views are registered onto which, and from
what they start, is said by :mod:`pipeline.registration.register`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.frames import RegisteredView
from pipeline.registration.again import (
    GROWN,
    Again,
    Counts,
    judged_again,
    register_again,
    renumbered,
    stale_patches,
    with_pixels_of,
)
from pipeline.registration.carried import carry_motions, carry_pixels
from pipeline.registration.inverse import inverted
from pipeline.registration.method import Layout
from pipeline.registration.parallax import identity
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import Terms, Thresholds, ViewRegistration
from pipeline.registration.strips import register_strips
from pipeline.registration.verdict import registered_view
from pipeline.registration.window_fits import windows_of
from pipeline.registration.windows import Landed, WindowFit, land, pixels_of, register_windows


@dataclass(frozen=True, kw_only=True, eq=False)
class Before:
    """Two views in the previous frame, and what has happened to them since."""

    registration: ViewRegistration
    changed: tuple[Counts, Counts]
    """Pixels in the source and in the reference, counted."""
    turn: int


def register_view(
    source: PreparedView,
    reference: PreparedView,
    terms: Terms,
    *,
    through: tuple[ViewRegistration, ViewRegistration] | None = None,
    before: Before | None = None,
) -> ViewRegistration:
    """Return one view registered onto one reference.

    Parameters
    ----------
    through : (source onto another reference, that reference onto this one), optional
        Where given, motions start from the composition of the two.
    before : Before, optional
        The same two views in the previous frame.
    """
    if source.view.view_id == reference.view.view_id:
        return _onto_itself(source)
    method, noise = terms.method, terms.noise
    if method.layout is Layout.STRIPS:
        fitted, labels, position, offset = register_strips(source, reference, method, noise)
        return ViewRegistration(
            registered=registered_view(source, reference, position, offset, terms.thresholds),
            motions=fitted, parallax=None, patch_labels=labels, offset=offset,
        )  # fmt: skip
    start = None
    if before is not None:
        start = before.registration.parallax
        again = register_again(
            source, reference, before.registration, before.changed, noise, before.turn, method.model
        )
        if again is not None:
            return _renewed_or_better(source, reference, again, before, terms)
    fit = register_windows(source, reference, method, noise, through, start)
    return landed_view(source, reference, fit, terms)


def _renewed_or_better(
    source: PreparedView,
    reference: PreparedView,
    again: Again,
    before: Before,
    terms: Terms,
) -> ViewRegistration:
    """Return a view with what was fitted anew, or from scratch where that explains it much better.

    What was tried in vain is not tried again in each frame.
    """
    old = before.registration
    misfits, tried = again.misfits(terms.noise), old.misfit
    if misfits and again.misfit > GROWN * tried:
        fit = register_windows(source, reference, terms.method, terms.noise, None, old.parallax)
        if again.is_beaten_by(fit):
            return landed_view(source, reference, fit, terms)
        tried = again.misfit
    renewed = _renewed(source, reference, again, before, terms)
    return replace(renewed, misfit=tried if misfits else 0.0)


def landed_view(
    source: PreparedView,
    reference: PreparedView,
    fit: WindowFit,
    terms: Terms,
) -> ViewRegistration:
    """Return a view whose windows are fitted, each of its pixels with one of their motions."""
    landed = land(source, reference, fit, terms.noise, terms.method)
    return ViewRegistration(
        registered=registered_view(
            source, reference, landed.position, landed.offset, terms.thresholds
        ),
        motions=fit.fitted,
        parallax=fit.parallax,
        prior=fit.prior,
        patch_labels=landed.labels,
        offset=landed.offset,
    )


def _onto_itself(source: PreparedView) -> ViewRegistration:
    height, width = source.view.luma.shape
    position = np.empty((height, width, 2), np.float32)
    position[..., 0] = np.arange(width)
    position[..., 1] = np.arange(height)[:, None]
    return ViewRegistration(
        registered=RegisteredView(
            view_id=source.view.view_id,
            observed=source.view.luma,
            position=position,
            registration_weights=np.zeros((height, width), np.float32),
            flags=np.zeros((height, width), np.uint8),
            confidence=np.ones((height, width), np.float32),
            is_reference=True,
        ),
        motions=None,
        parallax=identity(),
        patch_labels=np.zeros((height, width), np.int32),
        offset=np.zeros((height, width), np.float32),
    )


def seen_again(before: ViewRegistration, source: PreparedView) -> ViewRegistration:
    """Return a view registered onto itself, as in the previous frame, with the pixels of this."""
    registered = replace(before.registered, observed=source.view.luma)
    return replace(before, registered=registered, missed=None)


def _renewed(
    source: PreparedView,
    reference: PreparedView,
    again: Again,
    before: Before,
    terms: Terms,
) -> ViewRegistration:
    """Return a registration of the previous frame with the changed pixels' landing points."""
    old = before.registration
    if not again.fitted.any():
        return replace(with_pixels_of(old, source), fresh=again.fresh)
    kept = Landed(
        labels=renumbered(old.patch_labels, again.kept), position=old.registered.position,
        offset=old.offset,
    )  # fmt: skip
    landed = land(
        source, reference, again.fit, terms.noise, terms.method, before=(kept, again.fresh)
    )
    pixels = pixels_of(again.fresh, old.offset.shape)
    renewed = judged_again(pixels)
    return ViewRegistration(
        registered=registered_view(
            source, reference, landed.position, landed.offset, terms.thresholds,
            before=(old.registered, pixels, renewed),
        ),
        motions=again.fit.fitted,
        parallax=again.fit.parallax,
        prior=again.fit.prior,
        patch_labels=landed.labels,
        offset=landed.offset,
        renewed=renewed,
        fresh=again.fresh,
    )  # fmt: skip


def carried_view(
    source: PreparedView,
    reference: PreparedView,
    lead: ViewRegistration,
    before: Before,
    terms: Terms,
) -> ViewRegistration | None:
    """Return a registration of the previous frame with what another reference tells of a view.

    None where that one was registered from scratch, or this one must be.
    """
    old = before.registration
    stale = stale_patches(source, reference, old, before.changed, terms.noise, before.turn)
    if (
        stale is None or lead.fresh is None or old.motions is None or old.parallax is None
        or old.prior is None or lead.prior is None
    ):  # fmt: skip
        return None
    fresh = lead.fresh.copy()
    fresh.flat[windows_of(old.motions).cell[stale]] = True
    if not fresh.any():
        return replace(with_pixels_of(old, source), fresh=fresh)
    offset = old.prior.offset_mean - lead.prior.offset_mean
    kept = Landed(
        labels=old.patch_labels, position=old.registered.position, offset=old.offset
    )  # fmt: skip
    pixels = pixels_of(fresh, old.offset.shape)
    landed = carry_pixels(source, lead, old.parallax, offset, kept, pixels)
    renewed = judged_again(pixels)
    return replace(
        old,
        registered=registered_view(
            source, reference, landed.position, landed.offset, terms.thresholds,
            before=(old.registered, pixels, renewed),
        ),
        motions=carry_motions(lead, old.parallax, offset),
        patch_labels=landed.labels,
        offset=landed.offset,
        renewed=renewed,
        fresh=fresh,
    )  # fmt: skip


def inverse_view(
    source: PreparedView,
    reference: PreparedView,
    lead: ViewRegistration,
    rig: ViewRegistration,
    thresholds: Thresholds,
) -> ViewRegistration:
    """Return a view registered onto a reference, from how that one is registered onto the view.

    Parameters
    ----------
    lead : ViewRegistration
        The reference onto the view.
    rig : ViewRegistration
        The view onto the reference in the previous frame.
    """
    landed = inverted(lead, reference.fine.nearness, source.fine.nearness)
    return ViewRegistration(
        registered=registered_view(source, reference, landed.position, landed.offset, thresholds),
        motions=None,
        parallax=rig.parallax,
        prior=rig.prior,
        patch_labels=landed.labels,
        offset=landed.offset,
    )
