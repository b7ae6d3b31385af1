"""An amplifier that is late by whole servo periods: no fault while it is sound, and one as soon as it is not."""

import math
import re
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from controller.servo.interface import Fault, Notice, Output, State
from controller.servo.settings import DELAY_TICKS, Settings
from controller.waveforms.bank import Bank, Method
from tests.benches.servo import AMPLIFIER
from tests.benches.servo import Bench as PromptBench
from transopt.base.errors import InputError
from transopt.plant.discretise import split_delay

SAMPLES, HALF = 400, 7  # of the excitation, a square of 3 A; ticks of one of its halves
LATE_TICKS = [0.68, 0.95, 1.0, 1.5, 3.95, 4.0]
SQUARE_A = 3.0 * np.where(np.arange(SAMPLES) // HALF % 2 == 0, 1.0, -1.0)


def stated(dt_s: float, ticks: float) -> Settings:
    amplifier = replace(AMPLIFIER, delay_s=ticks * dt_s)
    return Settings(dt_s, 0.0, 4.0, amplifier, host_starts=True, stuck_A_s=1e3, stuck_s=1e3)


class Bench(PromptBench):
    """The stylus is still; what was commanded flows by the delay later."""

    def __init__(self, settings: Settings, true_s: float) -> None:
        command = np.append(SQUARE_A, 0.0)[None, None]
        table = Bank(Method.BILINEAR, [1.0], [0.0], command, [[0.0]], [[0.0]], 0.0, False, False)
        super().__init__(settings, table, lambda _: 2e-3)
        whole, rest_s = split_delay(true_s, settings.dt_s)
        self.under_way = deque([0.0] * (whole + 2), maxlen=whole + 2)
        self.parts_s = rest_s, settings.dt_s - rest_s
        self.flows = 1.0  # part of it

    def step(self) -> Output:
        output = self.servo.step(self.reading())
        self.under_way.append(output.command_A)
        for command_A, part_s in zip(self.under_way, self.parts_s, strict=False):
            left = math.exp(-AMPLIFIER.rate_rad_s * part_s)
            self.current_A = left * self.current_A + (1 - left) * self.flows * command_A
        self.tick += 1
        self.outputs.append(output)
        return output

    def play(self) -> "Bench":
        self.run(5)
        assert self.servo.arm()
        assert self.servo.excite()
        self.run(SAMPLES + 10)
        return self


@pytest.mark.parametrize("rate_Hz", [1000, 20_000])
@pytest.mark.parametrize("ticks", LATE_TICKS)
def test_a_late_amplifier_is_sound_at_every_rate(rate_Hz: int, ticks: float) -> None:
    dt_s = 1 / rate_Hz
    bench = Bench(stated(dt_s, ticks), ticks * dt_s).play()
    assert set(bench.events()) <= {Notice.FINISHED, Notice.COMMAND_SATURATED}
    assert Notice.FINISHED in bench.events()


def test_one_that_is_later_than_stated_is_none() -> None:
    bench = Bench(stated(1e-3, 0.0), 4e-3).play()
    assert bench.servo.fault in {Fault.NO_CURRENT, Fault.WRONG_CURRENT}


@pytest.mark.parametrize("ticks", LATE_TICKS)
@pytest.mark.parametrize(("flows", "fault"), [(0.0, Fault.NO_CURRENT), (0.5, Fault.WRONG_CURRENT)])
def test_a_late_amplifier_that_is_broken_is_told(ticks: float, flows: float, fault: Fault) -> None:
    bench = Bench(stated(1e-4, ticks), ticks * 1e-4)
    # Halves so long that the rule of 2 ms can tell.
    bench.servo.bank.command_A[0, 0, :-1] = 2.0
    bench.flows = flows
    bench.play()
    assert bench.servo.fault is fault
    at = next(k for k, output in enumerate(bench.outputs) if output.state is State.FAULT)
    assert at - 5 < 5e-3 / 1e-4


def test_a_longer_delay_is_refused_with_a_period_at_which_it_is_not() -> None:
    words = r"amplifier\.delay_s = 0\.5 ms: .* up to 4 servo periods, 0\.4 ms"
    with pytest.raises(InputError, match=words) as refused:
        stated(1e-4, DELAY_TICKS + 1)
    named = re.search(r"time\.dt_s of ([\d.e-]+) s", str(refused.value))
    dt_s = float(named[1])
    assert stated(dt_s, 5e-4 / dt_s).delay_s == pytest.approx(DELAY_TICKS * dt_s)
