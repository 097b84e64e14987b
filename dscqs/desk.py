"""The desk: takes what pages and operators ask for, and gives out what they may see.

It puts plan, order, session, store and shelf together, and knows nothing of HTTP. Every request
becomes an event; the event is stored before the desk answers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dscqs.displays import DisplayProfile, DisplayShelf
from dscqs.errors import DisplayError, NotFound, NotLoggedIn, OrderError, PlanError, UsedUp
from dscqs.group import Group
from dscqs.live_session import LiveSession
from dscqs.order import ORDER_VERSION, Kind, Presentation, make_order
from dscqs.plan import Plan, plan_from_dict, plan_to_dict
from dscqs.session import (
    Continued,
    Effect,
    Erased,
    Event,
    FormFilled,
    Graded,
    Grades,
    Joined,
    Noted,
    Offered,
    Paused,
    Resumed,
    Session,
    Shown,
    Withdrawn,
    after,
    event_from_data,
    event_to_data,
    make_steps,
)
from dscqs.shelf import Shelf
from dscqs.store import SessionRecord, SessionStore, TestRecord
from dscqs.views import presentation_view, progress_view, state_view

ACTIONS: dict[str, type] = {
    "pause": Paused, "resume": Resumed, "withdraw": Withdrawn, "erase": Erased
}  # fmt: skip
"""What an operator does to a session, by the name of it."""

LANGUAGES = ("en", "de", "fr", "es", "tr", "ja")

_CODE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,31}")


class Desk:
    """Conducts all sessions of a store.

    Parameters
    ----------
    store : SessionStore
    shelf : Shelf
    displays : DisplayShelf
    clock : callable
        Seconds since the epoch.
    secret : callable
        Returns a text that nobody can guess.
    """

    def __init__(
        self,
        store: SessionStore,
        shelf: Shelf,
        displays: DisplayShelf,
        *,
        clock: Callable[[], float] = time.time,
        secret: Callable[[], str] = lambda: secrets.token_urlsafe(24),
    ) -> None:
        self.store = store
        self.shelf = shelf
        self.displays = displays
        self._clock = clock
        self._secret = secret
        self._lock = threading.RLock()
        self._cookie_lock = threading.Lock()
        self._group_lock = threading.RLock()
        self._live: dict[str, LiveSession] = {}
        self._cookies: dict[str, str] = {}

    # Operators

    def make_test(self, plan: Plan, source: Path) -> TestRecord:
        """Store a plan and its stimuli.

        Raises
        ------
        PlanError
            If a display has no profile.
        StimulusError
            If a stimulus is missing, damaged, or unlike the others of its content.
        """
        known = self.displays.all()
        for display in plan.displays:
            if display not in known:
                raise PlanError(
                    f"displays: {display!r} is none of {', '.join(known)}; store its profile first"
                )
        files = self.shelf.take_in(plan, source)
        record = TestRecord(
            id=f"t{secrets.token_hex(6)}", name=plan.name, plan=plan_to_dict(plan), files=files,
            created=self._clock(),
        )  # fmt: skip
        self.store.add_test(record)
        return record

    def invite(self, test: str, assessor: str, display: str, language: str = "en") -> tuple[
        SessionRecord, str
    ]:  # fmt: skip
        """Return the session of an assessor on a display, and a link into it.

        The session is made where there is none, and its order stored; where there is one, the
        new link goes on with it, and earlier links and cookies end when it is opened.

        Raises
        ------
        DisplayError
            If the display has fewer pixels than a stimulus: nothing is ever scaled.
        """
        plan = self._plan_for(test, display)
        _check_invitation(plan, assessor, display, language)
        with self._lock:
            others = self.store.sessions(test)
            record = next(
                (one for one in others if (one.assessor, one.display) == (assessor, display)), None
            )
            if record is None:
                number = sum(one.display == display and one.role != "phone" for one in others)
                record = self._new_session(plan, test, assessor, display, language, number)
                self.store.add_session(record)
        link = self._secret()
        self.store.add_link(hashed(link), record.id)
        return record, link

    def invite_group(
        self, test: str, assessors: Sequence[str], display: str, language: str = "en"
    ) -> tuple[str, dict[str, str]]:
        """Return a link for the screen of a group, and one for the telephone of each assessor."""
        plan = self._plan_for(test, display)
        if not assessors or len(set(assessors)) != len(assessors):
            raise PlanError("assessors: must be a list of at least one code, each once")
        for assessor in assessors:
            _check_invitation(plan, assessor, display, language)
        with self._lock:
            others = self.store.sessions(test)
            taken = {one.assessor for one in others if one.display == display}
            for assessor in assessors:
                if assessor in taken:
                    raise OrderError(f"{assessor} has a session on {display} already")
            number = sum(one.display == display and one.role != "phone" for one in others)
            name = f"screen-{sum(one.role == 'screen' for one in others) + 1}"
            screen = self._new_session(plan, test, name, display, language, number)
            screen = dataclasses.replace(screen, role="screen", group=screen.id)
            records = [screen]
            for assessor in assessors:
                phone = self._new_session(plan, test, assessor, display, language, number)
                records.append(dataclasses.replace(phone, role="phone", group=screen.id))
            links = []
            for record in records:
                self.store.add_session(record)
                links.append(self._secret())
                self.store.add_link(hashed(links[-1]), record.id)
        return links[0], dict(zip(assessors, links[1:], strict=True))

    def act(self, session: str, action: str) -> dict[str, Any]:
        """Pause, resume, withdraw or erase; return the progress of the session."""
        if action not in ACTIONS:
            raise NotFound(f"there is no action {action!r} (known: {', '.join(ACTIONS)})")
        live = self._get(session)
        if action == "erase":  # first, so that a kill in between leaves no answers behind
            self.store.erase(session)
        self._take(live, ACTIONS[action]())
        self._settle(live)
        return progress_view(live)

    def progress(self, test: str) -> list[dict[str, Any]]:
        """Return where the sessions of a test stand."""
        self.store.test(test)
        return [progress_view(self._get(record.id)) for record in self.store.sessions(test)]

    def of_test(self, test: str, session: str) -> str:
        """Return the id of a session given by it or by its assessor; it must be of the test."""
        found = [
            record.id
            for record in self.store.sessions(test)
            if session in (record.id, record.assessor)
        ]
        if len(found) != 1:
            what = "no session" if not found else "more than one session (name it by its id)"
            raise NotFound(f"{session!r} has {what} in this test")
        return found[0]

    # Assessors

    def enter(self, link: str, cookie: str) -> str:
        """Use a link up for who shows the cookie; return the session.

        Again with the same cookie, as where the first answer was lost: lets in as the first time.
        """
        with self._cookie_lock:
            session = self.store.use_link(hashed(link), hashed(cookie))
            for key in [key for key, owner in self._cookies.items() if owner == session]:
                del self._cookies[key]
        self._take(self._get(session), Joined())
        return session

    def identify(self, cookie: str | None) -> str:
        """Return the session that a cookie lets in."""
        key = hashed(cookie) if cookie else ""
        session = self._cookies.get(key)
        if session is None:
            session = self.store.session_of(key)
            if session is None:
                raise NotLoggedIn(
                    "open the link that you were given; it works once, in one browser"
                )
            with self._cookie_lock:  # not while a newer link is being opened
                if self.store.session_of(key) == session:
                    self._cookies[key] = session
        return session

    def state(self, session: str) -> dict[str, Any]:
        """Return where the session stands, as the assessor may know it."""
        live = self._get(session)
        self._settle(live)
        return self._view(live)

    def display(self, session: str) -> Mapping[str, Any]:
        """Return the profile of the session's display."""
        return self._get(session).record.profile

    def proceed(self, session: str, stage: str) -> dict[str, Any]:
        """Leave a stage that asks for nothing more."""
        live = self._get(session)
        if live.record.role == "screen" and live.state.is_shown:
            with self._group_lock:
                if stage != live.state.step.stage:
                    raise OrderError(f"the session is at {live.state.step.stage.value}")
                if live.state.is_shown:  # the last vote may have come in between
                    self._group(live).go_on(self._take)
            return self._view(live)
        return self._take(live, Continued(stage=stage))

    def fill(self, session: str, stage: str, answers: Mapping[str, Any]) -> dict[str, Any]:
        """Store the answers of a form, and go on."""
        live = self._get(session)
        self._take(live, FormFilled(stage=stage), form=(stage, answers))
        self._settle(live)
        return self._view(live)

    def present(self, session: str) -> dict[str, Any]:
        """Give out the presentation to show, under a new ticket; earlier ones end.

        The bytes of both sides are made here, so that fetching them takes the same time.
        """
        live = self._get(session)
        if live.record.role == "phone":
            raise OrderError("the screen shows, the telephone votes")
        with live.lock:
            offered = Offered(ticket=self._secret())
            after(live.state, offered)  # refuses before anything is read
            presentation = live.state.step.presentation
            assert presentation is not None
            ready = {side: self._bytes(live, presentation, side) for side in "AB"}
            tokens = {side: self._secret() for side in "AB"}
            self._take(live, offered)
            live.sides = {tokens[side]: data for side, data in ready.items()}
            return presentation_view(live, tokens)

    def side(self, session: str, token: str) -> tuple[bytes, str]:
        """Return the bytes of one side and their media type; a token works once."""
        live = self._get(session)
        with live.lock:
            data = live.sides.pop(token, None)
        if data is None:
            raise UsedUp("the address was used before, or the presentation is no longer this one")
        return data, "image/png" if live.plan.kind == "still" else "video/webm"

    def shown(
        self, session: str, ticket: str, outcome: str, log: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Store how a presentation went; one that failed is offered again."""
        live = self._get(session)
        with live.lock:
            if outcome == "ok" and ticket == live.state.ticket:
                if live.sides:
                    raise OrderError("a side of the presentation has not been fetched")
                wrong = self._wrong_pixels(live, log.get("pixels"))
                if wrong:
                    fault = {"kind": "pixels", "detail": f"{wrong}: other pixels were shown"}
                    outcome, log = "failed", {**log, "faults": [fault]}
            self._take(live, Shown(ticket=ticket, outcome=outcome, log=log))
        self._settle(live)
        return self._view(live)

    def grade(self, session: str, ticket: str, submission: str, grades: Grades) -> dict[str, Any]:
        """Store a vote; the same submission counts once."""
        live = self._get(session)
        if live.record.role == "screen":
            raise OrderError("the screen shows, the telephones vote")
        self._take(live, Graded(ticket=ticket, submission=submission, grades=grades))
        self._settle(live)
        return self._view(live)

    def note(self, session: str, kind: str, detail: Mapping[str, Any]) -> None:
        """Add what the page says to the audit trail."""
        self._take(self._get(session), Noted(kind=kind, detail=detail))

    # Inside

    def _view(self, live: LiveSession) -> dict[str, Any]:
        with live.lock:
            group = self._group(live) if live.record.role == "screen" else None
            return state_view(live, group)

    def _group(self, live: LiveSession) -> Group:
        screen = self._get(live.record.group or "")
        phones = [
            self._get(record.id)
            for record in self.store.sessions(screen.record.test)
            if record.group == screen.record.id and record.role == "phone"
        ]
        return Group(screen=screen, phones=phones)

    def _settle(self, live: LiveSession) -> None:
        """Bring a group together after something happened in one of its sessions."""
        if live.record.group is not None:
            with self._group_lock:
                self._group(live).settle(self._take, self._secret)

    def _take(
        self, live: LiveSession, event: Event, *, form: tuple[str, Mapping[str, Any]] | None = None
    ) -> dict[str, Any]:
        with live.lock:
            state, effects = after(live.state, event)
            if Effect.FORGET_EVENT not in effects:
                self.store.append(live.record.id, [event_to_data(event)], form=form)
                live.state = state
                live.learn(event, self._clock())
            if Effect.END_ADDRESSES in effects:
                live.sides = {}
        return self._view(live)

    def _get(self, session: str) -> LiveSession:
        live = self._live.get(session)
        if live is None:  # only this waits for the disk
            with self._lock:
                live = self._live.get(session) or self._load(session)
                self._live[session] = live
        return live

    def _load(self, session: str) -> LiveSession:
        record = self.store.session(session)
        test = self.store.test(record.test)
        plan = plan_from_dict(test.plan)
        order = [Presentation(**{**item, "kind": Kind(item["kind"])}) for item in record.order]
        state = Session(steps=make_steps(plan, order, record.role), dimensions=plan.dimensions)
        live = LiveSession(record=record, plan=plan, state=state, files=test.files)
        for stored in self.store.events(session):
            event = event_from_data(stored.name, stored.data)
            live.state, _ = after(live.state, event)
            live.learn(event, stored.at)
        return live

    def _plan_for(self, test: str, display: str) -> Plan:
        """Return the plan of a test, once every stimulus fits the display."""
        record = self.store.test(test)
        plan = plan_from_dict(record.plan)
        if display in plan.displays:
            _check_size(record.files, display, self.displays.get(display))
        return plan

    def _new_session(
        self, plan: Plan, test: str, assessor: str, display: str, language: str, number: int
    ) -> SessionRecord:
        order = make_order(plan, number, display)
        return SessionRecord(
            id=f"s{secrets.token_hex(8)}", test=test, number=number, assessor=assessor,
            display=display, language=language, order_version=ORDER_VERSION,
            order=tuple(dataclasses.asdict(item) for item in order), created=self._clock(),
            profile=self.displays.get(display).as_dict(),
        )  # fmt: skip

    def _wrong_pixels(self, live: LiveSession, pixels: object) -> str:
        """Return the sides whose pixels, as reported, are not those of the stimulus."""
        presentation = live.state.step.presentation
        if presentation is None or not isinstance(pixels, Mapping):
            return ""
        known = {side: live.files[_key(live, presentation, side)].get("pixels") for side in "AB"}
        return " and ".join(
            side for side, right in known.items() if right and pixels.get(side, right) != right
        )

    def _bytes(self, live: LiveSession, presentation: Presentation, side: str) -> bytes:
        return self.shelf.serving(live.files[_key(live, presentation, side)])


def _key(live: LiveSession, presentation: Presentation, side: str) -> str:
    is_reference = presentation.reference_is_a == (side == "A")
    condition = live.plan.reference if is_reference else presentation.condition
    return f"{presentation.content}/{condition}"


def hashed(secret: str) -> str:
    """Return what is stored of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _check_size(
    files: Mapping[str, Mapping[str, Any]], display: str, profile: DisplayProfile
) -> None:
    if profile.mode == "webxr":
        return
    for key, file in files.items():
        eye = file["width"] // 2, file["height"]
        if any(one > most for one, most in zip(eye, profile.eye_px, strict=True)):
            raise DisplayError(
                f"{key}: has {eye[0]}×{eye[1]} pixels for each eye, and {display} "
                f"{profile.eye_px[0]}×{profile.eye_px[1]}; nothing is scaled, so take another "
                "display, or smaller stimuli"
            )


def _check_invitation(plan: Plan, assessor: str, display: str, language: str) -> None:
    if not _CODE.fullmatch(assessor):
        raise PlanError(
            f"assessor: {assessor!r} is not a code (letters, digits, . _ -; no name of a person)"
        )
    if display not in plan.displays:
        raise PlanError(f"display: {display!r} is none of {', '.join(plan.displays)}")
    if language not in LANGUAGES:
        raise PlanError(f"language: {language!r} is none of {', '.join(LANGUAGES)}")
