"""What the entries of a library are for: incoming speeds and grips, or named targets."""

from dataclasses import dataclass

from transopt.base.shown import cut, span


@dataclass(frozen=True)
class Axes:
    """The rows and columns of a library, in words.

    Attributes
    ----------
    speeds_m_s : (nv,) rising; zeros where the rows are named targets.
    grips_N : (ng,) rising; 0 alone where nobody holds the device.
    targets : (nv,) names; none where the rows are speeds.
    """

    speeds_m_s: tuple[float, ...]
    grips_N: tuple[float, ...]
    targets: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[tuple[float, str], ...]:
        """Speed and target of each row: the target is empty where there are speeds, the speed 0 of a target."""
        return tuple(zip(self.speeds_m_s, self.targets or ("",) * len(self.speeds_m_s), strict=True))

    @property
    def entries(self) -> int:
        """How many there are."""
        return len(self.speeds_m_s) * len(self.grips_N)

    @property
    def said(self) -> str:
        """In one line."""
        if self.targets:
            shown = ", ".join(self.targets[:3]) + (", ..." if len(self.targets) > 3 else "")
            return f"{len(self.targets)} target{'s' if len(self.targets) > 1 else ''} {cut(shown)}"
        return f"{span(self.speeds_m_s, 'm/s', 'speed')}, {span(self.grips_N, 'N', 'grip')}"

    @property
    def columns(self) -> list[str]:
        """Heads of the columns that say which entry a row of a table is."""
        return ["target"] if self.targets else ["speed m/s", "grip N"]

    def cells(self, iv: int, ig: int) -> list[str]:
        """Cells of one entry, one for each of these columns."""
        return [self.targets[iv]] if self.targets else [f"{self.speeds_m_s[iv]:g}", f"{self.grips_N[ig]:g}"]

    def place(self, iv: int, ig: int) -> str:
        """One entry in a sentence: "0.3 m/s, 3 N", or the name of its target."""
        return self.targets[iv] if self.targets else f"{self.speeds_m_s[iv]:g} m/s, {self.grips_N[ig]:g} N"
