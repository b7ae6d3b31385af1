"""Axes of a library: rows are incoming speeds or named targets, columns are devices, by grip and place."""

from dataclasses import dataclass

from transopt.base.shown import cut, span


@dataclass(frozen=True)
class Axes:
    """The rows and columns of a library, and their descriptions as text.

    Attributes
    ----------
    speeds_m_s : (nv,) increasing; zeros if the rows are named targets.
    grips_N : (ng,) grip of each device, increasing; a single 0 for a free device. For an arm each grip is repeated
        for each place.
    targets : (nv,) names; empty if the rows are speeds.
    places : (ng,) normal and posture of each device, by number from 1; empty for any plant but an arm.
    """

    speeds_m_s: tuple[float, ...]
    grips_N: tuple[float, ...]
    targets: tuple[str, ...] = ()
    places: tuple[tuple[float, float], ...] = ()

    @property
    def devices(self) -> tuple[tuple[float, tuple[float, float] | None], ...]:
        """Grip and place of each column; the place is None for any plant but an arm."""
        return tuple(zip(self.grips_N, self.places or (None,) * len(self.grips_N), strict=True))

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of different grips, normals and postures; columns are ordered with the grips outermost."""
        normals, postures = zip(*self.places, strict=True) if self.places else ((1,), (1,))
        return len(set(self.grips_N)), int(max(normals)), int(max(postures))

    @property
    def by_grip(self) -> dict[float, list[int]]:
        """Grip -> its columns, one for each place."""
        found: dict[float, list[int]] = {}
        for ig, grip in enumerate(self.grips_N):
            found.setdefault(grip, []).append(ig)
        return found

    @property
    def rows(self) -> tuple[tuple[float, str], ...]:
        """Speed and target of each row: the target is empty if the rows are speeds, the speed is 0 if targets."""
        return tuple(zip(self.speeds_m_s, self.targets or ("",) * len(self.speeds_m_s), strict=True))

    @property
    def entries(self) -> int:
        """Number of entries."""
        return len(self.speeds_m_s) * len(self.grips_N)

    @property
    def in_words(self) -> str:
        """The axes in one line."""
        if self.targets:
            shown = ", ".join(self.targets[:3]) + (", ..." if len(self.targets) > 3 else "")
            return f"{len(self.targets)} target{'s' if len(self.targets) > 1 else ''} {cut(shown)}"
        _, normals, postures = self.sizes
        at = (
            f", {normals} normal{'s' * (normals > 1)}, {postures} posture{'s' * (postures > 1)}"
            if self.places
            else ""
        )
        return f"{span(self.speeds_m_s, 'm/s', 'speed')}, {span(tuple(self.by_grip), 'N', 'grip')}{at}"

    @property
    def columns(self) -> list[str]:
        """Headings of the table columns that identify an entry."""
        return (
            ["target"] if self.targets else ["speed m/s", "grip N", *(("normal", "posture") if self.places else ())]
        )

    def cells(self, iv: int, ig: int) -> list[str]:
        """Cells of one entry under the headings of `columns`."""
        if self.targets:
            return [self.targets[iv]]
        at = self.places[ig] if self.places else ()
        return [f"{each:g}" for each in (self.speeds_m_s[iv], self.grips_N[ig], *at)]

    def place(self, iv: int, ig: int) -> str:
        """One entry as text: "0.3 m/s, 3 N", with its place for an arm, or the name of its target."""
        return self.targets[iv] if self.targets else f"{self.speeds_m_s[iv]:g} m/s, {self.device(ig)}"

    def device(self, ig: int) -> str:
        """One device as text: "3 N", or "3 N, normal 1, posture 2"."""
        at = ", normal {:g}, posture {:g}".format(*self.places[ig]) if self.places else ""
        return f"{self.grips_N[ig]:g} N{at}"
