"""Windows over the page that ask or explain."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pcore.studio.help_text import HELP


def ask_to_restore(gui: Any, restore: Callable[[], None]) -> None:
    """Offer what an earlier page could not save.

    Args:
        gui: of a tab.
        restore: called where it is taken.
    """
    with gui.add_modal("Unsaved edits were found") as modal:
        gui.add_markdown("An earlier page ended before its edits were saved.")
        for label, take in (("Restore", True), ("Not now", False)):
            button = gui.add_button(label, color=None if take else "gray")

            @button.on_click
            async def _(_: Any, take: bool = take) -> None:
                modal.close()
                if take:
                    restore()


def show_help(gui: Any) -> None:
    """Show keys and mouse in a tab."""
    with gui.add_modal("Keys and mouse") as modal:
        gui.add_markdown(HELP)
        close = gui.add_button("Close")

        @close.on_click
        async def _(_: Any) -> None:
            modal.close()
