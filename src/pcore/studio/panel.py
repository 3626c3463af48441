"""What the parts of the page's panel share: widgets that tell wishes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Wish = Callable[..., None]
"""Takes the number of the tab, then what the widget says."""


class Panel:
    """A part of the panel."""

    def __init__(self, gui: Any, wishes: Mapping[str, Wish]) -> None:
        """Begin without widgets.

        Args:
            gui: of viser's server.
            wishes: what to do by name, see `Studio.wishes`.
        """
        self._gui, self._wishes = gui, wishes

    def _say(self, wish: str, event: Any, *values: Any) -> None:
        if event.client_id is not None:  # None: the server changed the value itself.
            self._wishes[wish](int(event.client_id), *values)

    def _on_click(self, button: Any, wish: str, *values: Any) -> None:
        @button.on_click
        async def _(event: Any) -> None:
            self._say(wish, event, *values)

    def _on_choice(self, group: Any, wish: str, *values: Any) -> None:
        @group.on_click
        async def _(event: Any) -> None:
            self._say(wish, event, *values, event.target.value)

    def _on_update(
        self, widget: Any, wish: str, *values: Any, said: Mapping[str, Any] | None = None
    ) -> None:
        """Tell every new value; by a mapping, what it stands for."""

        @widget.on_update
        async def _(event: Any) -> None:
            value = event.target.value
            self._say(wish, event, *values, value if said is None else said[value])
