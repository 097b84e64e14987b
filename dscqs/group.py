"""A group before one screen: the screen shows, each assessor votes on a telephone.

Screen and telephones are sessions of one order. The screen leads: when it has shown a
presentation, every telephone gets a ticket of its own for it; when all have voted, the screen
goes on. What a telephone missed (it came late, or was paused) is skipped, never made up.
Everything here follows from the states, so that a kill in between is made good at the next
request.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dscqs.live_session import LiveSession
from dscqs.session import SHOWN, Advanced, Event, Offered, Shown, Skipped, Standing

Take = Callable[[LiveSession, Event], object]
"""Stores an event of a session."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """A screen and the telephones before it."""

    screen: LiveSession
    phones: Sequence[LiveSession]

    @property
    def active(self) -> list[LiveSession]:
        """The telephones whose votes count now."""
        return [phone for phone in self.phones if phone.state.standing is Standing.ACTIVE]

    @property
    def waited_for(self) -> list[LiveSession]:
        """The telephones that have not voted on what the screen has shown."""
        here = self.screen.state.num_shown
        return [
            phone
            for phone in self.active
            if phone.state.step.stage in SHOWN and phone.state.num_shown == here
        ]

    @property
    def given(self) -> int:
        """How many have voted on it."""
        here = self.screen.state.num_shown
        return sum(phone.state.num_shown > here for phone in self.active)

    def settle(self, take: Take, secret: Callable[[], str]) -> None:
        """Bring everybody to where the screen is, and the screen on when all have voted."""
        screen = self.screen.state
        for phone in self.active:
            while phone.state.step.stage in SHOWN and phone.state.num_shown < screen.num_shown:
                take(phone, Skipped())
        if not screen.is_shown:
            return
        for phone in self.waited_for:
            if not phone.state.is_shown:
                ticket = secret()
                take(phone, Offered(ticket=ticket))
                take(phone, Shown(ticket=ticket, outcome="ok", log={"screen": screen.ticket}))
        if self.given and not self.waited_for:
            take(self.screen, Advanced())

    def go_on(self, take: Take) -> None:
        """Go on without the votes that are missing."""
        for phone in self.waited_for:
            take(phone, Skipped())
        take(self.screen, Advanced())
