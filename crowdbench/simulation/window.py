"""Windows on a screen: each environment has one of its own, and closing it leaves the others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pygame

_open: list[Window] = []
"""All windows of this process; the display is given up with the last of them."""


class Window:
    """A window that shows pictures until it is closed, by the program or by whoever watches."""

    def __init__(self, pygame: Any, title: str, size: tuple[int, int]) -> None:
        """Open it with the given inner size [px]."""
        self._pygame = pygame
        pygame.display.init()
        self._window = pygame.Window(title, size)
        self.closed = False
        _open.append(self)

    def show(self, picture: pygame.Surface) -> None:
        """Replace what is shown, then see to events, which all windows have in common."""
        self._window.get_surface().blit(picture, (0, 0))
        self._window.flip()
        pygame = self._pygame
        for event in pygame.event.get():
            escape = event.type == pygame.KEYDOWN and event.key in (pygame.K_ESCAPE, pygame.K_q)
            if event.type == pygame.QUIT:
                for window in list(_open):
                    window.close()
            elif escape or event.type == pygame.WINDOWCLOSE:
                for window in list(_open):
                    if window._window is getattr(event, "window", None):
                        window.close()
            if not _open:
                break

    def close(self) -> None:
        """Close it; closing it again does nothing."""
        if self.closed:
            return
        self.closed = True
        _open.remove(self)
        self._window.destroy()
        if not _open:
            self._pygame.display.quit()
