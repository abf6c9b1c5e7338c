"""Which rows each node of a cluster goes on with: neighbours stay together, nodes come and go."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence


class Shares:
    """Positions in the order of rendering that nobody renders yet; some are set aside for a node, the rest are free.

    Parameters
    ----------
    n
        How many there are.

    Examples
    --------
    >>> shares = Shares(10)
    >>> shares.take("a", 4), shares.take("b", 4), shares.take("a", 4)
    (range(0, 4), range(7, 10), range(4, 7))
    """

    def __init__(self, n: int) -> None:
        self._free: deque[Sequence[int]] = deque([range(n)] if n else [])
        self._own: dict[str, Sequence[int]] = {}
        self._avoiding: dict[int, set[str]] = {}

    def take(self, node: str, most: int, *, only: bool = False) -> Sequence[int]:
        """The next positions for a node; none if nothing is left for it.

        A node whose own are done takes what is free, and then half of the longest that another has.

        Parameters
        ----------
        node
            Its name.
        most
            How many, at most.
        only
            Whether there is no other node, so that it takes what another should have taken.
        """
        own = self._own.pop(node, ()) or self._next_free("" if only else node) or self._half()
        if own[most:]:
            self._own[node] = own[most:]
        return own[:most]

    def leave(self, node: str) -> None:
        """A node is gone: what was set aside for it is free."""
        if own := self._own.pop(node, ()):
            self._free.append(own)

    def give_back(self, positions: Sequence[int], *, avoiding: str = "") -> None:
        """Somebody shall render these, and soon; not the node `avoiding`, unless there is no other."""
        self._free.appendleft(positions)
        if avoiding:
            for position in positions:
                self._avoiding.setdefault(position, set()).add(avoiding)

    def _next_free(self, node: str) -> Sequence[int]:
        for i, piece in enumerate(self._free):
            if node not in self._avoiding.get(piece[0], ()):
                del self._free[i]
                return piece
        return ()

    def _half(self) -> Sequence[int]:
        longest = max(self._own, key=lambda node: len(self._own[node]), default=None)
        if longest is None:
            return ()
        own = self._own.pop(longest)
        keep = len(own) // 2
        if keep:
            self._own[longest] = own[:keep]
        return own[keep:]
