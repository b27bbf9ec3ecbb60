"""The live page beside a run: its process comes with the run, and never ends it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from deepseis_bringup.graph import NodeSpec
from deepseis_bringup.live.web_options import WebOptions
from deepseis_bringup.supervisor import Supervisor, ending

NAME: Final = "web"
FIRST_WAIT_S, LONGEST_WAIT_S = 1.0, 30.0
"""Time before a page that died is started again; doubled with every death [s]."""
HEALTHY_S: Final = 60.0
"""A page that lived so long is started again as if it had never died [s]."""


def page_spec(options: WebOptions) -> NodeSpec:
    """Describe the page's process: no member of the graph, whose members wait for others."""
    parameters = {
        "port": options.port,
        "address": options.address,
        "token_file": str(Path(options.token_file).resolve()) if options.token_file else "",
        "names": list(options.names),
    }
    return NodeSpec(NAME, "deepseis_bringup", NAME, NAME, (), (), NAME, parameters)


class LivePage:
    """The page's process: started again when it has died, after a while that grows.

    Parameters
    ----------
    supervisor : Supervisor
        Of the page alone.
    say : callable
        Told when it died.
    clock : callable, optional
        [s]
    """

    def __init__(
        self,
        supervisor: Supervisor,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.supervisor, self.say, self.clock = supervisor, say, clock
        self._wait, self._due, self._started = FIRST_WAIT_S, 0.0, 0.0

    def start(self) -> None:
        """Start the process."""
        self._started, self._due = self.clock(), 0.0
        self.supervisor.start()

    def tend(self) -> None:
        """Look whether it lives; start it again when its time has come."""
        now = self.clock()
        if self._due:
            if now >= self._due:
                self.start()
            return
        status = self.supervisor.statuses().get(NAME)
        if status is None:
            return
        if now - self._started > HEALTHY_S:
            self._wait = FIRST_WAIT_S
        line = self.supervisor.last_line(NAME)
        self.say(f"live page {ending(status)}: {line}; again in {self._wait:g} s")
        self._due, self._wait = now + self._wait, min(2 * self._wait, LONGEST_WAIT_S)


@contextmanager
def live_page(
    options: WebOptions | None,
    folder: Path,
    say: Callable[[str], None],
    environment: Mapping[str, str] | None = None,
    namespace: str = "",
) -> Iterator[Sequence[LivePage]]:
    """Run the page for the while; yields it, or nothing if there is to be none."""
    if options is None:
        yield ()
        return
    options.check()
    supervisor = Supervisor(
        [page_spec(options)], folder, namespace=namespace, environment=environment or {}
    )
    page = LivePage(supervisor, say)
    try:
        page.start()
        say(f"live page: {options.url}")
        yield (page,)
    finally:
        supervisor.stop()
