"""A port without Arduino, compiled for this machine: the core that it links with, and the life that it shows."""

import subprocess
from pathlib import Path

import pytest

from controller.device.circuit_file import CIRCUITS, load_circuit
from controller.firmware.build import CORE, FIRMWARE, NoCompilerError, compiler, sources

SRC, BUILT = FIRMWARE / "src", load_circuit(CIRCUITS["escon_re25"])[0]
PORTS = {
    "double": (),
    "float": ("-DTD_REAL_FLOAT",),
    "small": ("-DTD_MAX_LIBRARY_SAMPLES=1000", "-DTD_MAX_SPEEDS=4", "-DTD_MAX_GRIPS=4", "-DTD_MAX_RECORDS=64"),
    "long": ("-DTD_MAX_SAMPLES=30000",),
}
START = """
#include "core/td_device.h"
static td_device device;
int main(void) { const td_port port = {0}; td_device_start(&device, &port); return 0; }
"""


@pytest.fixture(scope="module")
def cores(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The core's objects by what they were compiled with."""
    try:
        cc = compiler().command
    except NoCompilerError as missing:
        pytest.skip(str(missing))
    found = {}
    for name, flags in PORTS.items():
        folder = tmp_path_factory.mktemp(name)
        subprocess.run([*cc, "-O0", *flags, f"-I{SRC}", "-c", *map(str, sources(CORE))], cwd=folder, check=True)
        found[name] = sorted(map(str, folder.glob("*.o")))
    return found


ALIKE = [(name, name) for name in PORTS]
UNLIKE = [("double", "float"), ("float", "double"), ("small", "double"), ("long", "small"), ("double", "long")]


@pytest.mark.parametrize(("port", "core"), [*ALIKE, *UNLIKE])
def test_a_port_links_only_with_a_core_of_its_own_precision_and_capacities(
    cores: dict[str, list[str]], port: str, core: str, tmp_path: Path
) -> None:
    (tmp_path / "port.c").write_text(START)
    made = tmp_path / "port"
    command = [*compiler().command, "-O1", *PORTS[port], f"-I{SRC}", str(tmp_path / "port.c"), *cores[core], "-lm"]
    linked = subprocess.run([*command, "-o", str(made)], check=False, capture_output=True, text=True)
    if port == core:
        assert linked.returncode == 0, linked.stderr
        assert subprocess.run([made], check=False).returncode == 0
    else:
        assert linked.returncode != 0
        assert f"td_device_of_{'float' if port == 'float' else 'double'}" in linked.stderr


LOOP = """
#include <stdio.h>
#include <stdlib.h>
#include "board.h"
#include "hardware.h"
static unsigned alive, came;
static uint32_t kept[BOARD_KEPT];
void board_start(void) {}
uint32_t board_next_boot(void) { return 1; }
void board_start_ticks(void) {}
uint32_t board_cycles(void) { return 0; }
uint32_t board_period_cycles(void) { return 16800; }
void board_alive(bool level) { (void)level; alive++; }
int32_t board_encoder(void) { return 0; }
uint32_t board_converted(int input) { (void)input; return 2048; }
bool board_stop_pressed(void) { return false; }
void board_put(uint32_t counts, bool enabled) { (void)counts; (void)enabled; }
void board_hold(bool held) { (void)held; }
size_t board_receive(uint8_t *bytes, size_t room) { (void)bytes; (void)room; return 0; }
size_t board_send(const uint8_t *bytes, size_t size) { (void)bytes; return size; }
volatile uint32_t *board_kept(void) { return kept; }
void board_wait(void)
{
    static const unsigned ticks[] = {1, 400, AWAY, 1};
    unsigned j;
    if (came > 0)
        printf("%u ", alive);
    alive = 0;
    if (came == sizeof ticks / sizeof ticks[0])
        exit(0);
    for (j = 0; j < ticks[came]; j++)
        port_tick();
    came++;
}
"""


def test_a_bare_board_shows_no_life_where_its_loop_hangs_in_the_ticks(tmp_path: Path) -> None:
    try:
        cc = compiler().command
    except NoCompilerError as missing:
        pytest.skip(str(missing))
    half_a_second = round(0.5 / BUILT.hardware.dt_s)
    (tmp_path / "loop.c").write_text(LOOP)
    port = FIRMWARE / "port"
    own = ("-std=c11", f"-I{SRC}", f"-I{port}", f"-DAWAY={half_a_second + 700}u")
    files = map(str, (tmp_path / "loop.c", port / "main.c", *sources(CORE)))
    subprocess.run([*cc, *own, *files, "-lm", "-o", str(tmp_path / "loop")], check=True)
    done = subprocess.run([str(tmp_path / "loop")], capture_output=True, text=True, check=True, timeout=60)
    assert [int(word) for word in done.stdout.split()] == [1, 400, half_a_second, 1]
