"""Found against the device from outside, each by name: refused or harmless, in double and in single precision."""

import math
from dataclasses import replace

import numpy as np
import pytest

from controller.protocol import messages as m
from controller.protocol.capacity import REST_BETWEEN_PULSES_S
from controller.protocol.codes import EVENT_CODES, EVENTS, REASONS, Kind, Reason, Stage
from controller.protocol.configuration import configuration_of
from controller.protocol.image import HEADER as IMAGE_HEADER
from controller.protocol.image import IMAGE_FIELDS, image_of, sha256
from controller.protocol.wire import encode
from controller.servo.interface import Fault, Output, Readings, State
from controller.servo.settings import Settings
from tests.benches.compiled import DT_S, smooth_bank
from tests.benches.device import IMAGE, ONE_WAVEFORM, REST, SETTINGS, Talker
from tests.benches.servo import AMPLIFIER
from tests.controller.firmware.conftest import COIL, HARDWARE, Start
from transopt.plant.amplifier import Amplifier

PUSH, PULSE_TICKS = 30.0, 150  # m/s^2 per A of a stylus that hangs free; ticks of the test pulse
REST_PULSE_TICKS = round(REST_BETWEEN_PULSES_S / DT_S)
LEASE_TICKS = 1000  # pulses end without a lease
PATH_M = PUSH * (PULSE_TICKS * DT_S) ** 2 / 2
WATCHED = replace(
    SETTINGS, pulse_ticks=PULSE_TICKS, pulse_grip_N=(3.0,), pulse_acceleration=(PUSH,), pulse_path_m=(PATH_M,)
)
EXCITED = replace(SETTINGS, host_starts=True)


class Plant:
    """A stylus that hangs free under an amplifier of its own: first order, with gains that may be wrong.

    Attributes
    ----------
    true_A, most_A : current now, and at most so far.
    leases : whether the host keeps its lease meanwhile.
    """

    def __init__(
        self,
        talker: Talker,
        *,
        amplifier: float = 1.0,
        monitor: float = 1.0,
        encoder: float = 1.0,
        accelerometer: float = 1.0,
        pole_Hz: float = 1050.0,
    ) -> None:
        self.leases = True
        self.talker, self.gains = talker, (amplifier, monitor, encoder, accelerometer)
        self.keep = math.exp(-2 * math.pi * pole_Hz * DT_S)
        self.true_A = self.most_A = self.speed = self.z = 0.0
        self.output = Output(0.0, State.IDLE, 0.0, 0.0, math.nan)

    def step(self, ticks: int) -> "Plant":
        amplifier, monitor, encoder, accelerometer = self.gains
        for tick in range(ticks):
            if self.leases and tick % LEASE_TICKS == 0:
                self.talker.tell(self.talker.lease())
            counts = math.floor((5e-3 + encoder * self.z) / SETTINGS.count_m + 0.5)
            readings = Readings(0, counts, 3.0, monitor * self.true_A, accelerometer * PUSH * self.true_A)
            self.output = self.talker.step(1, readings)
            self.true_A = self.keep * self.true_A + (1 - self.keep) * amplifier * self.output.command_A
            self.speed += PUSH * self.true_A * DT_S
            self.z += self.speed * DT_S
            # A hand holds it: what moved comes back to rest.
            self.speed *= 1.0 if self.output.command_A else 0.9
            self.most_A = max(self.most_A, abs(self.true_A))
        return self


def evidence(talker: Talker) -> m.EvidenceReply:
    found = talker.ask(m.Evidence())
    assert isinstance(found, m.EvidenceReply)
    return found


def pulses(talker: Talker, plant: Plant) -> m.EvidenceReply:
    """Three pairs of pulses to their end."""
    plant.step(200)
    talker.heard()
    talker.done(m.Pulse(WATCHED.pulse_A, PULSE_TICKS, 3))
    plant.step(6 * (1000 + PULSE_TICKS + 20))
    talker.heard()
    return evidence(talker)


def pulsed(talker: Talker, plant: Plant, settings: Settings = WATCHED) -> m.EvidenceReply:
    """Likewise, under a new configuration."""
    talker.configured(configuration_of(settings))
    return pulses(talker, plant)


def arm(settings: Settings, image: bytes, **others: float) -> m.Arm:
    hashes = sha256(configuration_of(settings)), sha256(image)
    return replace(m.Arm(0, 1000, 1.0, *hashes), **others)  # type: ignore[arg-type]


def test_a_sound_device_gathers_its_evidence_and_only_for_this_configuration(start: Start) -> None:
    talker = Talker(start(simulated=False))
    found = pulsed(talker, Plant(talker))
    assert (found.bits, found.stage, found.pulses) == (m.PULSE_SOUND, Stage.PULSED, 6)
    assert (found.current_ratio, found.acceleration_ratio) == pytest.approx((1.0, 1.0), abs=0.1)
    talker.loaded(IMAGE)
    assert talker.refused(arm(WATCHED, IMAGE)) is Reason.NO_TRIAL
    talker.done(m.Surface(3.0))
    assert evidence(talker).bits == m.PULSE_SOUND
    talker.configured(configuration_of(WATCHED))
    assert evidence(talker).bits == 0


@pytest.mark.parametrize(
    "wrong",
    [
        *({"amplifier": k} for k in (8.0, 3.0, -1.0, 0.3)),
        *({"monitor": k} for k in (4.0, -1.0, 0.0)),
        {"amplifier": 3.0, "monitor": 1 / 3},
        *({"accelerometer": k} for k in (-1.0, 2.0, 0.5, 0.0)),
        *({"encoder": k} for k in (-1.0, 3.0, 0.3)),
    ],
    ids=str,
)
def test_a_wrong_amplifier_monitor_encoder_or_accelerometer_is_not_armed(
    single: Start, wrong: dict[str, float]
) -> None:
    talker = Talker(single(simulated=False))
    assert pulsed(talker, Plant(talker, **wrong)).bits == 0
    talker.loaded(IMAGE)
    assert talker.refused(arm(WATCHED, IMAGE, trial=1, gain=0.1)) is Reason.NO_PULSE


def test_checked_is_no_frame_that_a_host_could_send(start: Start) -> None:
    assert "CHECKED" not in Kind.__members__
    talker = Talker(start(simulated=False))
    talker.configured(configuration_of(WATCHED)).loaded(IMAGE)
    for kind in range(1, 64):
        head = m.HEADER.pack(kind, 0, talker.sequence + 1, 9)
        talker.device.receive(encode(head + sha256(configuration_of(WATCHED))))
    talker.heard()
    talker.sequence += 2
    assert talker.refused(arm(WATCHED, IMAGE)) is Reason.NO_PULSE


def test_a_pole_of_a_millihertz_is_refused(start: Start) -> None:
    talker = Talker(start())
    answer = talker.configure(configuration_of(replace(SETTINGS, amplifier=replace(AMPLIFIER, pole_Hz=1e-3))))
    assert isinstance(answer, m.Refused)


def played(talker: Talker, plant: Plant, settings: Settings, image: bytes, times: int, ticks: int) -> None:
    """An excitation again and again, armed anew where a fault or a lease has ended it."""
    for _ in range(times):
        if plant.output.state is State.IDLE:
            talker.tell(arm(settings, image))
        talker.tell(talker.lease(), m.Start(0))
        plant.step(ticks)
        talker.heard()


def test_a_configuration_without_a_coil_does_not_burn_the_motor(start: Start) -> None:
    settings = replace(EXCITED, stuck_A_s=1e3, stuck_s=1e3)
    talker = Talker(start(heat_C=(90.0, 80.0)))
    talker.configured(configuration_of(settings))
    command = np.zeros((1, 1, 5000))
    command[..., :-20] = 4.0
    image = image_of(replace(smooth_bank(1, 1, 5000), command_A=command), DT_S, EXCITED.lead_s, 20)
    talker.loaded(image)
    plant = Plant(talker)
    winding, housing = 90.0, 80.0
    for _ in range(7):  # the fifth ends too hot
        if plant.output.state is State.IDLE:
            talker.tell(arm(settings, image))
        talker.tell(talker.lease(), m.Start(0))
        for _ in range(5000):
            plant.z = plant.speed = 0.0
            plant.step(1)
            power = 2.18 * (1 + 0.0039 * (winding - 25)) * (abs(plant.true_A) + 0.02) ** 2
            winding += DT_S * (power - (winding - housing) / 3.1) / (12.0 / 3.1)
            assert winding <= HARDWARE.limit_C
        talker.heard()
    assert plant.most_A > 3.5
    assert talker.device.look().fault is Fault.OVER_TEMPERATURE


@pytest.mark.parametrize("scale_A", [1e39, 3.5e38, math.inf, math.nan, -1.0])
def test_a_scale_beyond_single_precision_commands_no_nan(single: Start, scale_A: float) -> None:
    head = dict(zip((name for name, _ in IMAGE_FIELDS), IMAGE_HEADER.unpack_from(ONE_WAVEFORM), strict=True))
    image = IMAGE_HEADER.pack(*{**head, "scale_A": scale_A}.values()) + ONE_WAVEFORM[IMAGE_HEADER.size :]
    talker = Talker(single())
    talker.configured(configuration_of(EXCITED))
    assert isinstance(talker.upload(image), m.Refused)


def test_the_flowing_current_is_not_forgotten_by_a_configuration_in_one_write(start: Start) -> None:
    hard = replace(EXCITED, amplifier=replace(AMPLIFIER, command_limit=6.0), stuck_A_s=1e3)
    command = np.zeros((1, 1, 200))
    command[..., 0:2] = 6.0
    command[..., 2:-20] = 4.0
    image = image_of(replace(smooth_bank(1, 1, 200), command_A=command), DT_S, hard.lead_s, 20)
    for pole_Hz in (700.0, 1050.0, 1600.0):
        talker = Talker(start(heat_C=(30.0, 30.0)))
        talker.configured(configuration_of(hard))
        answer = talker.upload(image)
        if isinstance(answer, m.Refused):
            command[..., 0:2] = 4.0
            image = image_of(replace(smooth_bank(1, 1, 200), command_A=command), DT_S, hard.lead_s, 20)
            talker.loaded(image)
        plant = Plant(talker, pole_Hz=pole_Hz)
        plant.step(200)
        for _ in range(4):
            talker.tell(arm(hard, image), m.Start(0))
            plant.step(20)
            talker.tell(m.Disarm())
            talker.configure(configuration_of(hard))
            assert talker.refused(arm(hard, image)) is Reason.NOT_AT_REST
            plant.step(25)
        assert plant.most_A <= HARDWARE.current_A


def test_a_pulse_keeps_smaller_limits(start: Start) -> None:
    talker = Talker(start())
    talker.configured(configuration_of(replace(SETTINGS, current_limit_A=0.05)))
    assert talker.refused(m.Pulse(0.1, 20, 0)) is Reason.BAD_VALUE
    talker.done(m.Pulse(0.05, 20, 0))
    talker = Talker(start(hardware=replace(HARDWARE, pulse_A=0.02)))
    talker.configured()
    assert talker.refused(m.Pulse(0.05, 20, 0)) is Reason.BAD_VALUE


@pytest.mark.parametrize("seed", range(3))
def test_no_stated_scale_of_the_amplifier_lets_a_pulse_pass_the_hardwares_limit(single: Start, seed: int) -> None:
    """The scale is the host's word: neither it nor the truth may let more flow than the port allows."""
    random = np.random.default_rng(seed)
    # A scale of a fifth asks the hardware for five times the limits that are stated.
    weak = replace(WATCHED, current_limit_A=0.8, amplifier=replace(AMPLIFIER, command_limit=1.0))
    granted = 0
    for _ in range(6):
        scale = float(np.exp(random.uniform(np.log(0.2), np.log(5.0))) * random.choice([-1, 1]))
        asked = float(random.uniform(0.0, 1.2 * HARDWARE.pulse_A))
        allowed = max(asked, asked / abs(scale)) <= HARDWARE.pulse_A
        for truth in (1.0, scale):
            talker = Talker(single())
            talker.configured(configuration_of(replace(weak, amplifier_scale=scale)))
            plant = Plant(talker, amplifier=truth).step(200)
            if not allowed:
                assert talker.refused(m.Pulse(asked, PULSE_TICKS, 0)) is Reason.BAD_VALUE
                continue
            talker.done(m.Pulse(asked, PULSE_TICKS, 0))
            plant.step(REST_PULSE_TICKS + PULSE_TICKS + 20)
            assert 0 < plant.most_A <= HARDWARE.pulse_A * (1 + 1e-6)
            granted += 1
    assert granted


def test_norms_of_zero_do_not_skip_the_prediction_of_heat(start: Start) -> None:
    """They do not travel: the device computes them of the counts, and scales the transient down or withholds it."""
    warm = replace(EXCITED, coil=replace(COIL, start_winding_C=94.99, start_housing_C=60.0))
    bank = smooth_bank(1, 1, 2000, peak_A=4.0)
    image = image_of(replace(bank, transient_A=[[0.0]], feedback_A=[[0.0]]), DT_S, warm.lead_s, 10)
    talker = Talker(start())
    talker.configure(configuration_of(warm))
    talker.loaded(image)
    talker.step(30)
    talker.heard()
    talker.done(arm(warm, image))
    assert talker.refused(m.Start(0)) is Reason.TOO_HOT


@pytest.mark.parametrize("above_K", [-0.01, 0.01])
def test_nothing_is_armed_within_the_withheld_margin_below_the_coils_limit(single: Start, above_K: float) -> None:
    play_limit_C = COIL.limit_C - EXCITED.withhold_K
    warm = replace(EXCITED, coil=replace(COIL, start_winding_C=play_limit_C + above_K, start_housing_C=90.0))
    talker = Talker(single()).configured(configuration_of(warm)).loaded(ONE_WAVEFORM)
    if above_K > 0:
        assert talker.refused(arm(warm, ONE_WAVEFORM)) is Reason.TOO_HOT
    else:
        talker.done(arm(warm, ONE_WAVEFORM))


def test_too_few_readings_are_no_rest(start: Start) -> None:
    talker = Talker(start())
    talker.configure(configuration_of(SETTINGS))
    talker.loaded(IMAGE)
    assert talker.refused(arm(SETTINGS, IMAGE)) is Reason.NOT_AT_REST
    talker.step(19)
    assert talker.refused(m.Pulse(0.05, 20, 0)) is Reason.NOT_AT_REST
    talker.step(1)
    talker.done(arm(SETTINGS, IMAGE))
    talker.step(1, REST._replace(emergency_stop=True))
    talker.step(30)
    talker.tell(m.Reset())
    assert talker.refused(arm(SETTINGS, IMAGE)) is Reason.NOT_AT_REST


def test_the_amplifier_has_power_only_while_armed_or_pulsing(start: Start) -> None:
    talker = Talker(start())
    assert not talker.device.enabled
    talker.configured().loaded()
    talker.step(10)
    assert not talker.device.enabled
    talker.done(m.Pulse(0.05, 20, 0))
    powered = []
    for _ in range(REST_PULSE_TICKS + 30):
        talker.step()
        powered.append(talker.device.enabled)
    assert powered == [True] * (REST_PULSE_TICKS + 20) + [False] * 10
    talker.heard()
    talker.done(arm(SETTINGS, IMAGE))
    talker.step()
    assert talker.device.enabled
    talker.step(1, REST._replace(emergency_stop=True))
    assert not talker.device.enabled


def test_the_heat_of_the_coil_survives_a_restart_or_is_taken_at_its_most(start: Start) -> None:
    talker = Talker(start(heat_C=(97.0, 85.0)))
    talker.step(10)
    kept = talker.device.coil_C()
    assert kept == pytest.approx((97.0, 85.0), abs=0.1)
    assert start(heat_C=kept).coil_C() == pytest.approx(kept)
    steady = 30.0 + 70.0 * 14.0 / 17.1
    assert start(heat_C=None).coil_C() == pytest.approx((100.0, steady), abs=0.2)
    assert start(heat_C=(math.nan, 20.0)).coil_C()[0] == pytest.approx(100.0, abs=0.2)


def test_a_configuration_that_states_a_cold_coil_does_not_cool_the_devices_own(start: Start) -> None:
    cold = replace(EXCITED, coil=replace(COIL, start_winding_C=25.0, start_housing_C=25.0))
    talker = Talker(start(heat_C=(97.0, 85.0))).configured(configuration_of(cold)).loaded(ONE_WAVEFORM)
    look = talker.device.look()
    assert (look.winding_C, look.housing_C) == pytest.approx((97.0, 85.0), abs=0.1)
    assert talker.refused(arm(cold, ONE_WAVEFORM)) is Reason.TOO_HOT


def test_a_host_that_states_cooler_surroundings_plays_nothing_that_the_hardware_would_cut(start: Start) -> None:
    warm = replace(HARDWARE, ambient_C=96.0, tau_w_s=0.05, tau_h_s=0.2)
    stated = replace(EXCITED, coil=replace(COIL, ambient_C=25.0))
    talker = (
        Talker(start(hardware=warm, heat_C=(25.0, 25.0))).configured(configuration_of(stated)).loaded(ONE_WAVEFORM)
    )
    talker.done(arm(stated, ONE_WAVEFORM))
    Plant(talker).step(30_000)  # until it rests
    talker.heard()
    assert talker.device.look().winding_C == pytest.approx(96.0, abs=1.0)
    assert talker.refused(m.Start(0)) is Reason.TOO_HOT


def test_no_coil_may_be_hotter_than_the_hardwares(start: Start) -> None:
    talker = Talker(start())
    other = replace(EXCITED, coil=replace(COIL, limit_C=100.1))
    assert isinstance(refused := talker.configure(configuration_of(other)), m.Refused)
    assert (REASONS[refused.reason], refused.value) == (Reason.BEYOND_HARDWARE, 100.1)


def test_three_stops_have_three_names(start: Start) -> None:
    stops = {"emergency_stop": Fault.EMERGENCY_STOP, "late": Fault.LATE_TICK}
    for how, fault in stops.items():
        talker = Talker(start())
        talker.configured()
        assert talker.step(1, REST._replace(**{how: True})).state is State.FAULT
        assert talker.device.look().fault is fault
    talker = Talker(start())
    talker.configured().tell(m.EmergencyStop())
    talker.step()
    assert talker.device.look().fault is Fault.HOST_STOP
    told = [EVENTS[x.code] for x in talker.heard() if isinstance(x, m.Event)]
    assert told == [Fault.HOST_STOP]
    assert len({EVENT_CODES[fault] for fault in (Fault.HOST_STOP, *stops.values())}) == 3


def test_holds_that_are_not_yet_late_pass_the_limit_by_no_more_than_is_stated(start: Start) -> None:
    """The steepest rise that the limits allow, its two steps held for almost one and a half periods each."""
    most_A, limit_A = 6.0, 4.0
    hardware = replace(HARDWARE, current_A=limit_A, command_A=most_A)
    fast = math.exp(-2 * math.pi * hardware.pole_most_Hz * DT_S)
    last_A = most_A  # up to the limit in two steps from its opposite: first as far as this one needs
    first_A = ((limit_A - (1 - fast) * last_A) / fast + fast * limit_A) / (1 - fast)
    command = np.zeros((1, 1, 200))
    command[..., 2:40], command[..., 40], command[..., 41], command[..., 42:100] = -limit_A, first_A, last_A, limit_A
    image = image_of(replace(smooth_bank(1, 1, 200), command_A=command), DT_S, EXCITED.lead_s, 20)
    amplifier = replace(AMPLIFIER, pole_Hz=hardware.pole_most_Hz, command_limit=most_A, delay_s=0.0)
    settings = replace(EXCITED, amplifier=amplifier, stuck_A_s=1e3)
    talker = (
        Talker(start(hardware=hardware, heat_C=(30.0, 30.0))).configured(configuration_of(settings)).loaded(image)
    )
    talker.done(arm(settings, image), m.Start(0))
    flows_A, found_A = 0.0, []
    for _ in range(120):
        output = talker.step(1, REST._replace(current_A=flows_A))
        rises = output.command_A > 0.99 * first_A
        keep = fast ** (1.49 if rises else 1.0)
        flows_A = keep * flows_A + (1 - keep) * output.command_A
        found_A.append(flows_A)
    long = fast**1.5
    bound_A = (fast - long) * ((most_A - limit_A) / fast + long / (1 - long) * (most_A + limit_A))
    assert 0.7 * bound_A < max(found_A) - limit_A < bound_A


def test_a_configuration_knows_the_current_that_still_flows(start: Start) -> None:
    """An amplifier of 50 Hz still gives 3 A when the next waveform begins, which may not ask for all then."""
    slow_Hz = 50.0
    hardware = replace(HARDWARE, command_A=30.0, current_A=4.5, pole_least_Hz=slow_Hz, pole_most_Hz=slow_Hz)
    settings = replace(EXCITED, window_ticks=4, coil=None, amplifier=Amplifier(slow_Hz, 68e-6, 30.0), stuck_A_s=1e3)
    command = np.zeros((1, 1, 100))
    command[..., :4] = 29.0
    command[..., 4:80] = 3.5
    image = image_of(replace(smooth_bank(1, 1, 100), command_A=command), DT_S, settings.lead_s, 20)
    talker = Talker(start(hardware=hardware, heat_C=(30.0, 30.0)))
    talker.configured(configuration_of(settings)).loaded(image)
    keep, true_A, most_A = math.exp(-2 * math.pi * slow_Hz * DT_S), 0.0, 0.0

    def step(ticks: int) -> None:
        nonlocal true_A, most_A
        for _ in range(ticks):
            output = talker.step(1, REST._replace(current_A=true_A))
            true_A = keep * true_A + (1 - keep) * output.command_A
            most_A = max(most_A, abs(true_A))

    for _ in range(2):
        step(5)
        talker.heard()
        talker.done(arm(settings, image), m.Start(0))
        step(40)
        assert talker.device.state is State.PLAYING
        talker.tell(m.Disarm())
        talker.heard()
        assert isinstance(talker.configure(configuration_of(settings)), m.Done)
    assert 3.0 < most_A <= settings.current_limit_A * (1 + 1e-6)
