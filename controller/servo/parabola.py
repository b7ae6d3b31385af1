"""Rows of a parabola's least-squares fit, worked out in the order of operations that the C core has too."""

import math


def fit_rows(window_ticks: int, ahead_ticks: float) -> tuple[list[float], list[float]]:
    """What the fit through the readings of the ages 0 to window - 1 [ticks] gives, ahead of the newest.

    The normal equations of c_0 - c_1 age + c_2 age^2 are solved by the adjugate of their matrix.

    Returns
    -------
    value, slope : (3,) weights of sum counts, sum counts * age, sum counts * age^2 for the value and for the slope
        per tick, `ahead_ticks` after the newest reading.
    """
    s = [0.0] * 5
    for age in range(window_ticks):
        power = 1.0
        for j in range(5):
            s[j] += power
            power *= age
    c00, c01, c02 = s[2] * s[4] - s[3] * s[3], s[2] * s[3] - s[1] * s[4], s[1] * s[3] - s[2] * s[2]
    c11, c12, c22 = s[0] * s[4] - s[2] * s[2], s[1] * s[2] - s[0] * s[3], s[0] * s[2] - s[1] * s[1]
    rows = ((c00, c01, c02), (c01, c11, c12), (c02, c12, c22))
    determinant = s[0] * c00 + s[1] * c01 + s[2] * c02
    ahead = ahead_ticks
    value = [(rows[0][j] - ahead * rows[1][j] + ahead * ahead * rows[2][j]) / determinant for j in range(3)]
    slope = [(2 * ahead * rows[2][j] - rows[1][j]) / determinant for j in range(3)]
    return value, slope


def bend_row(window_ticks: int) -> list[float]:
    """(4,) weights of the sums of counts times age^0 to age^3: how much of a cubic is in the readings, in counts.

    The cubic that is orthogonal to every parabola over n ages is P(u) = u^3 - u (3 n^2 - 7) / 20 about their middle,
    with sum P^2 = n (n^2 - 1) (n^2 - 4) (n^2 - 9) / 2800 (Gram's polynomials). The answer is sum y P / sqrt(sum P^2):
    readings that differ from a parabola by independent errors of one size have that size there.
    """
    n = float(window_ticks)
    middle = (n - 1) / 2
    g = (3 * n * n - 7) / 20
    size = math.sqrt(n * (n * n - 1) * (n * n - 4) * (n * n - 9) / 2800)
    return [
        (g * middle - middle * middle * middle) / size,
        (3 * middle * middle - g) / size,
        -3 * middle / size,
        1 / size,
    ]
