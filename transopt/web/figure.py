"""The taps of a service as a figure of plotly: what the page shows, without a browser's window."""

from typing import TYPE_CHECKING

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.base.writing import percent
from transopt.web.service import Service

if TYPE_CHECKING:
    import plotly.graph_objects

INK = {"recorded": "#4c535b", "optimum": "#0b57a4", "clipped": "#a84300", "limit": "#8a1c5b"}  # as in page.css
DASH = {"recorded": "solid", "optimum": "solid", "clipped": "dash", "limit": "dot"}
ROW_PX = 150


def service_figure(service: Service) -> "plotly.graph_objects.Figure":
    """Two panels for every tap: its accelerations [g], and its input between the limits.

    A tap without a certified optimum has no optimum in the figure, and its title says why.
    """
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    taps = [service.quick(index) for index in range(len(service.places))]
    driven = service.scene.driven_by
    titles = [
        f"{place.title}: " + (f"{percent(tap.figures.tap_error)} %" if tap.figures is not None else tap.reason)
        for place, tap in zip(service.places, taps, strict=True)
    ]
    figure = make_subplots(
        len(taps),
        2,
        shared_xaxes=True,
        subplot_titles=[text for title in titles for text in (title, "")],
        vertical_spacing=0.25 / max(len(taps), 1),
        horizontal_spacing=0.08,
    )
    for row, tap in enumerate(taps, start=1):
        curves = tap.curves
        assert curves is not None
        t_ms = 1e3 * curves.times_s
        ends = np.array([t_ms[0], t_ms[-1]])
        g = STANDARD_GRAVITY_M_S2
        drawn = [
            ("clipped", t_ms, curves.clipped_m_s2 / g, 1),
            ("recorded", t_ms, curves.recorded_m_s2 / g, 1),
            *([("optimum", t_ms, curves.optimum_m_s2 / g, 1)] if tap.certified else []),
            ("clipped", t_ms, curves.clipped_input, 2),
            *([("optimum", t_ms, curves.input, 2)] if tap.certified else []),
            ("limit", ends, np.full(2, curves.input_limit), 2),
            ("limit", ends, np.full(2, -curves.input_limit), 2),
        ]
        for j, (name, x, y, column) in enumerate(drawn):
            line = {"color": INK[name], "dash": DASH[name], "width": 2 if name == "optimum" else 1.3}
            named = row == 1 and name not in [other for other, *_ in drawn[:j]]
            figure.add_trace(
                go.Scatter(x=x, y=y, name=name, legendgroup=name, showlegend=named, mode="lines", line=line),
                row=row,
                col=column,
            )
        figure.update_yaxes(title_text="g", row=row, col=1)
        figure.update_yaxes(title_text=driven.unit, row=row, col=2)
    figure.update_xaxes(title_text="time after contact, ms", row=len(taps))
    figure.update_layout(
        title=f"{service.scene.name}: acceleration, and {driven.name} between its limits",
        height=ROW_PX * len(taps) + 160,
        template="plotly_white",
    )
    return figure
