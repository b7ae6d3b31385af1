"""Further files of the one tap, of instruments and programs beside those of `tests.benches.brought_files`.

Names, units, remarks and separators follow each maker's description or an export that its users show.
"""

import numpy as np

from tests.benches.tap_formats import (
    RATE_HZ,
    TAP_M_S2,
    TIMES_S,
    Brought,
    V,
    axes,
    clock,
    hdf5,
    mat,
    rows,
    tdms,
    universal,
    workbook,
)
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G

FURTHER: list[Brought] = []
IN_G = TAP_M_S2 / G
MS = 1e3 * TIMES_S
US = np.round(1e6 * TIMES_S)
VOLTS = "V @ 100 mV/g"
X, Y, Z = axes()
X_G, Y_G, Z_G = X / G, Y / G, Z / G


def _add(name: str, data: str | bytes, lacks: str = "", **right: object) -> None:
    FURTHER.append(Brought(name, data if isinstance(data, bytes) else data.encode(), lacks, right))


def _scopes() -> None:
    one = "".join(f"{v:+.7E}\n" for v in V)
    _add(
        "keysight_infiniium.csv",
        "Revision:,0\nType:,raw\nStart:,0\nPoints:,3000\nCount:,1\nXDispRange:,+4.0E-01\nXDispOrg:,+0.0E+00\n"
        "XInc:,+1.000000E-04\nXOrg:,+0.0E+00\nYDispRange:,+4.0E+00\nYDispOrg:,+0.0E+00\nYInc:,+1.5E-05\n"
        "YOrg:,+0.0E+00\nMax Bandwidth:,+1.0E+08\nMin Bandwidth:,+0.0E+00\nXUnits:,second\nYUnits:,Volt\n"
        'Frame:,"DSO9064A:MY0000"\nDate:,"05 MAR 2024"\nTime:,"14:11:02"\nData:,\n' + one,
        "columns",
        units={"Data:": VOLTS},
    )
    _add(
        "yokogawa.csv",
        '"Header Size",16\n"Model Name","DLM2024"\n"Comment",""\n"BlockNumber",1\n"TraceName","CH1"\n'
        '"BlockSize",3000\n"VUnit","V"\n"SampleRate",1.0E+04\n"HResolution",1.0E-04\n"HOffset",0.0E+00\n"HUnit","s"\n'
        '"Date","2024/03/05"\n"Time","14:11:02.33"\n\n' + "".join(f",{v:.6E}\n" for v in V),
        "units",
        units={"CH1": VOLTS},
    )
    _add("rohde_schwarz.csv", "in s,CH1 in V\n" + rows(TIMES_S, V, form="{:.9E}"), "units", units={"CH1": VOLTS})
    _add(
        "hantek_remote.csv",
        "nr,time,ch1,ch2,ch1s,ch2s\n"
        + rows(np.arange(3000.0), TIMES_S, V, 0 * V - 0.02, np.round(300 * V), 0 * V - 76),
        "units",
        units={"time": "s", "ch1": VOLTS},
    )
    _add("hantek.csv", "#CLOCK=100.0uS\n#SIZE=3000\n#UNITS:V\n" + one, "columns", units={"values": VOLTS})
    _add(
        "owon.csv",
        "Channel :,CH1\nFrequency :,?\nPeriod :,?\nPK-PK :,1.4V\nAverage :,0.0V\nVertical pos :,0mv\n"
        "Probe attenuation :,1X\nVoltage per ADC value :,8.0mV\nTime interval :,0.10000mS\n\n"
        "index,CH1_Voltage(mV)\n" + rows(np.arange(3000.0), 1e3 * V),
        "units",
        units={"CH1_Voltage": "mV @ 100 mV/g"},
    )
    _add(
        "gw_instek.csv",
        "Format,2.0B,\nMemory Length,3000,\nIntpDistance,0,\nTrigger Address,999,\nTrigger Level,4.0E-01,\n"
        "Source,CH1,\nProbe,1X,\nVertical Units,V,\nVertical Scale,5.0E-01,\nVertical Position,0.0E+00,\n"
        "Horizontal Units,s,\nHorizontal Scale,4.0E-02,\nHorizontal Position,0.0E+00,\nHorizontal Mode,Main,\n"
        "Sampling Period,1.000E-04,\nFirmware,V1.20,\nTime,05-Mar-24 14:11:02,\nMode,Fast,\nWaveform Data,\n"
        + "".join(f"{v:.5f},\n" for v in V),
        "units",
        units={"Waveform Data": VOLTS},
    )
    stamps = [f"{stamp}+00:00" for stamp in clock("{day}T{hour}")]
    _add("saleae_clock.csv", "Time [s],Channel 0 [V]\n" + rows(stamps, V), "units", units={"Channel 0": VOLTS})
    _add(
        "tektronix_wavestar.csv",
        '"Model","TPS2024"\n"TIME","CH1"\n"s","V"\n' + rows(TIMES_S, V),
        "units",
        units={"CH1": VOLTS},
    )


def _systems() -> None:
    _add(
        "diadem.csv",
        ("Zeit;Beschl_1\ns;m/s²\nLABELX;\n" + rows(TIMES_S, TAP_M_S2, mark=";").replace(".", ",")).encode("cp1252"),
    )
    commas = [stamp.replace(".", ",") for stamp in clock("{d}.{m}.{y} {hour}")]
    dotted = [f"05.03.2024 {stamp.split()[1]}" for stamp in commas]
    _add(
        "labview_waveform.txt",
        "waveform\t[0]\nt0\t05.03.2024 14:11:02,000000\ndelta t\t1,000000E-4\n\ntime[0]\tY[0]\n"
        + rows(dotted, [f"{a:.6E}".replace(".", ",") for a in IN_G], mark="\t"),
        "units",
        units={"Y[0]": "g"},
    )
    _add(
        "dewesoft_comma.csv",
        "Data info\n\nFile name: tap.dxd\nStart time: 05.03.2024 14:11:02\nNumber of channels: 1\n"
        "Sample rate: 10000 Hz\nStore type: always fast\n\nTime (s);AI 1 (m/s2)\n"
        + rows(TIMES_S, TAP_M_S2, mark=";").replace(".", ","),
    )
    _add(
        "bk_pulse.txt",
        "Header Size:\t12\nVersion:\t5\nDelimiter:\tTAB\nDecimal Symbol:\t.\nFormat:\tSINGLE\nTitle1:\tTime(tap)\n"
        "Title2:\tMark 1\nX-axis unit:\ts\nX-axis delta:\t0.0001\nY-axis unit:\tm/s^2\nNumber of Points:\t3000\n\n"
        + "".join(f"{k}\t{t:.7e}\t{a:.7e}\n" for k, (t, a) in enumerate(zip(TIMES_S, TAP_M_S2, strict=True), 1)),
        "columns",
        columns=["-", "time [s]", "acc [m/s^2]"],
    )
    _add(
        "catman.txt",
        "HBM_CATMANEASY_DATAFILE_40\ncatman Version: 5.2\nT0 = 05.03.2024 14:11:02\n\n"
        "Time  1 - default sample rate [s]\tACC_1 [m/s²]\n" + rows(TIMES_S, TAP_M_S2, mark="\t"),
    )
    _add(
        "labchart.txt",
        "Interval=\t0.0001 s\nExcelDateTime=\t4.5356591E4\t05/03/2024 14:11:02.000000\nTimeFormat=\tStartOfBlock\n"
        "DateFormat=\t\nChannelTitle=\tAcceleration\tTrigger\nRange=\t10.000 V\t10.000 V\nUnitName=\tm/s^2\tV\n"
        "TopValue=\t500.000\t10.000\nBottomValue=\t-500.000\t-10.000\n"
        + rows(TIMES_S, TAP_M_S2, np.zeros(TIMES_S.size), mark="\t"),
    )
    signals = {"values": TAP_M_S2[:, None], "label": "acc", "dimensions": 1.0}
    _add(
        "simulink.mat",
        mat(simout={"time": TIMES_S[:, None], "signals": signals, "blockName": "model/To Workspace"}),
        "units",
        units={"time": "s", "values": "m/s^2"},
    )
    _add(
        "dewesoft.mat",
        mat(Data1_AI_1=IN_G[:, None], Data1_time_AI_1=TIMES_S[:, None], Sample_rate=RATE_HZ, Start_time=45356.6),
        "units",
        units={"Data1_time_AI_1": "s", "Data1_AI_1": "g"},
    )
    _add(
        "matrix.mat",
        mat(data=np.column_stack([TIMES_S, TAP_M_S2])),
        "units",
        units={"data 1": "s", "data 2": "m/s^2"},
    )
    _add("timed.tdms", tdms({"Time": (TIMES_S, "s"), "Acceleration": (IN_G, "g"), "Force": (0 * IN_G, "N")}))
    _add("diadem.tdms", tdms({"Beschl_1": (TAP_M_S2, "m/s²")}, {"wf_increment": 1e-4, "wf_xunit_string": "s"}))
    _add(
        "labview_multi.lvm",
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nX_Columns\tMulti\n***End_of_Header***\t\n\t\n"
        "Channels\t2\t\nSamples\t3000\t\t3000\nY_Unit_Label\tg\t\tN\nX_Dimension\tTime\t\tTime\nX0\t0.0E+0\t\t0.0E+0\n"
        "Delta_X\t1.000000E-4\t\t1.000000E-4\n***End_of_Header***\t\t\t\t\n"
        "X_Value\tAcceleration\tX_Value\tForce\tComment\n" + rows(TIMES_S, IN_G, TIMES_S, 0 * IN_G, mark="\t"),
    )
    _add(
        "flexlogger.csv",
        "Time - Acceleration_0,Amplitude - Acceleration_0\n" + rows(TIMES_S, IN_G),
        "units",
        units={"Time - Acceleration_0": "s", "Amplitude - Acceleration_0": "g"},
    )
    velocity = np.cumsum(TAP_M_S2) * 1e-4
    _add(
        "polytec.txt",
        "Source File Name:\tD:\\tap.pvd\nPoint Index:\t1\nComponent:\tTime\nSignal:\tVib - Velocity\n\n"
        "Time\tVelocity\n[ s ]\t[ m/s ]\n" + rows(TIMES_S, velocity, mark="\t", form="{:.12g}"),
    )
    _add("testlab.txt", "Time\tPoint1:+Z\ns\tg\n" + rows(TIMES_S, IN_G, mark="\t"))
    _add("rate_word.csv", "Abtastrate: 10 kHz\nBeschleunigung [g]\n" + rows(IN_G))
    _add("rate_k.csv", "Sampling rate: 10k\nacc [g]\n" + rows(IN_G))
    _add("rate_per_second.txt", "10000 samples/s\nacc_g\n" + rows(IN_G), "rate_Hz", rate_Hz=1e4)
    thousands = [f"{1e3 * a:,.3f}".replace(",", "_").replace(".", ",").replace("_", ".") for a in IN_G]
    _add(
        "thousands.csv",
        "Zeit [s];Beschleunigung [mg]\n" + rows([f"{t:.4f}".replace(".", ",") for t in TIMES_S], thousands, mark=";"),
    )
    _add("units_164.uff", _in_units(5, universal(("NONE", "12"), values=1e3 * TAP_M_S2)))
    _add(
        "sheet_dates.xlsx",
        workbook([("Time [s]", "Acc (m/s²)"), *zip(TIMES_S.tolist(), TAP_M_S2.tolist(), strict=True)]),
    )
    _add(
        "nested.h5",
        hdf5(
            {"run/acc/x": (X, "m/s^2"), "run/acc/y": (Y, "m/s^2"), "run/acc/z": (Z, "m/s^2"), "run/t": (TIMES_S, "s")}
        ),
    )


def _in_units(code: int, functions: bytes) -> bytes:
    """A universal file with a dataset 164 of units before its functions; 5 are mm, mN."""
    names = {5: "mm (milli-newton)"}
    factors = {5: (1e3, 1e3, 1.0, 273.15)}
    lines = [f"{code:10d}{names[code]:20s}{2:10d}", "".join(f"{each:25.17E}" for each in factors[code][:3])]
    lines.append(f"{factors[code][3]:25.17E}")
    return ("    -1\n   164\n" + "\n".join(lines) + "\n    -1\n").encode() + functions


def _wearables() -> None:
    epoch = [f"{1709647862000 + t:.1f}" for t in MS]
    zoned = clock("{day}T14.11.{hour}")
    _add(
        "metawear.csv",
        "epoch (ms),timestamp (+0100),elapsed (s),x-axis (g),y-axis (g),z-axis (g)\n"
        + rows(epoch, zoned, TIMES_S, X_G, Y_G, Z_G),
    )
    _add(
        "shimmer.csv",
        "sep=\t\nS_Timestamp_CAL\tS_Accel_LN_X_CAL\tS_Accel_LN_Y_CAL\tS_Accel_LN_Z_CAL\t\n"
        "ms\tm/(s^2)\tm/(s^2)\tm/(s^2)\t\n" + rows(MS, X, Y, Z, mark="\t", end="\t\n"),
    )
    _add(
        "xsens_dot.csv",
        "sep=,\nDeviceTag:,Xsens DOT\nFirmwareVersion:,2.0.0\nOutputRate:,10000Hz\nMeasurementMode:,\n\n"
        "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z\n"
        + rows(np.arange(3000.0), 4e6 + US, X, Y, Z, form="{:.10g}"),
        "units",
        units={"SampleTimeFine": "us", "acceleration": "m/s^2"},
    )
    nano = [f"{1709647862000000000 + round(1e9 * t)}" for t in TIMES_S]
    _add(
        "sensor_logger_raw.csv",
        "time,seconds_elapsed,z,y,x\n" + rows(nano, TIMES_S, Z, Y, X),
        "units",
        columns=["-", "seconds_elapsed", "z", "y", "x"],
        units={"acceleration": "m/s^2"},
    )
    _add(
        "sensorlog_ios.csv",
        "loggingTime(txt),accelerometerTimestamp_sinceReboot(s),accelerometerAccelerationX(G),"
        "accelerometerAccelerationY(G),accelerometerAccelerationZ(G)\n"
        + rows(clock("{day} {hour} +0100"), 5000 + TIMES_S, X_G, Y_G, Z_G),
    )
    _add(
        "endaq.csv",
        '"Time","X (100g)","Y (100g)","Z (100g)"\n' + rows(TIMES_S, X_G, Y_G, Z_G),
        "units",
        units={"time": "s", "acceleration": "g"},
    )
    _add(
        "vernier.csv",
        "Latest: Time (s),Latest: X-axis acceleration (m/s²),Latest: Y-axis acceleration (m/s²),"
        "Latest: Z-axis acceleration (m/s²)\n" + rows(TIMES_S, X, Y, Z),
    )
    _add("pasco.csv", "Time (s) Run #1,Acceleration (m/s²) Run #1\n" + rows(TIMES_S, TAP_M_S2))
    _add(
        "hobo.csv",
        '"Plot Title: tap"\n"#","Date Time, GMT+00:00","Z Accel, g (LGR S/N: 101, SEN S/N: 101)"\n'
        + "".join(
            f"{k},{s},{a:.6f}\n" for k, (s, a) in enumerate(zip(clock("{m}/{d}/24 {hour}"), IN_G, strict=True), 1)
        ),
    )
    _add(
        "magnitude.csv",
        "DateTime;Magnitude;X;Y;Z\n" + rows(clock("{day} {hour}"), np.sqrt(X**2 + Y**2 + Z**2), X, Y, Z, mark=";"),
        "units",
        units={"acceleration": "m/s^2"},
    )


def _boards() -> None:
    counts = [np.round(each * 2048) for each in (X_G, Y_G, Z_G)]
    _add(
        "adafruit.txt",
        "Adafruit MPU6050 test!\nMPU6050 Found!\n"
        + "".join(f"X: {x:.3f} \tY: {y:.3f} \tZ: {z:.3f} \tm/s^2 \n" for x, y, z in zip(X, Y, Z, strict=True)),
        "rate_Hz",
        rate_Hz=1e4,
    )
    _add(
        "putty.log",
        "=~=~=~=~=~=~=~=~=~=~=~= PuTTY log 2024.03.05 14:11:02 =~=~=~=~=~=~=~=~=~=~=~=\n"
        "t_us,acc_g\n" + rows(US, IN_G, form="{:.10g}"),
    )
    _add(
        "blackbox.csv",
        "loopIteration, time (us), accSmooth[0], accSmooth[1], accSmooth[2]\n"
        + rows(np.arange(3000.0), US, *counts, mark=", ", form="{:.10g}"),
        "units",
        units={"acceleration": "LSB @ 2048 LSB/g"},
    )
    _add(
        "px4.csv",
        "timestamp,device_id,x,y,z,temperature,error_count\n"
        + rows(36_000_000 + US, 0 * US + 3014666, X, Y, Z, 0 * X + 31.5, 0 * X, form="{:.12g}"),
        "units",
        units={"timestamp": "us", "acceleration": "m/s^2"},
    )
    nano = [f"{1709647862000000000 + round(1e9 * t)}" for t in TIMES_S]
    _add(
        "ros.csv",
        "%time,field.header.seq,field.header.frame_id,field.linear_acceleration.x,field.linear_acceleration.y,"
        "field.linear_acceleration.z\n" + rows(nano, np.arange(3000.0), ["imu"] * 3000, X, Y, Z),
        "units",
        units={"time": "ns", "acceleration": "m/s^2"},
    )
    _add(
        "picoquake.csv",
        "# PLab PicoQuake Data\n# Time: 2024-03-05 14:11:02.333682, Device: D4E9 (E66)\n"
        "# Num. samples: 3000, Duration: 0.3 s\n"
        "# Config: data_rate = 10000.0 Hz, filter = 488 Hz, acc_range = 16 g, gyro_range = 250.0 dps\n"
        "# Integrity: True, Skipped samples: 0\n\ncount,a_x,a_y,a_z,g_x,g_y,g_z\n"
        + rows(np.arange(3000.0), X_G, Y_G, Z_G, 10 * X, 10 * Y, 10 * X),
        "units",
        units={"acceleration": "g"},
    )
    _add(
        "unico.txt",
        "STEVAL-MKI209V1K (IIS2ICLX)\n\nA_X [mg]\tA_Y [mg]\tA_Z [mg]\n"
        + rows(1e3 * X_G, 1e3 * Y_G, 1e3 * Z_G, mark="\t"),
        "rate_Hz",
        rate_Hz=1e4,
    )
    _add(
        "unicleo.txt",
        "time[us]\tA_X [mg]\tA_Y [mg]\tA_Z [mg]\n"
        + rows(US, 1e3 * X_G, 1e3 * Y_G, 1e3 * Z_G, mark="\t", form="{:.10g}"),
    )
    _add("load.csv", "Time [s],Load [g]\n" + rows(TIMES_S, IN_G), "units", units={"Load": "g"})
    _add("load_beside.csv", "Time [s],Load Cell [g],CH2 [g]\n" + rows(TIMES_S, 30 + 0 * X, IN_G))
    statistics = "\nStatistics\nMinimum,-0.01\nMaximum,13.6\nStop time,2024-03-05 14:11:03\n"
    _add("statistics.csv", "time [s],acc [g]\n" + rows(TIMES_S, IN_G) + statistics)
    _add("killed.txt", "Zeit [s];Beschleunigung [g]\n" + rows(TIMES_S, IN_G, mark=";").replace(".", ",") + "0,30")
    _add("bare_a.csv", "time [s],a,b\n" + rows(TIMES_S, 0.01 * X, IN_G), "units", units={"b": "g"})
    _add("inches.csv", "time [s],acc\n" + rows(TIMES_S, TAP_M_S2 / G), "units", units={"acc": "g"})


for _kind in (_scopes, _systems, _wearables, _boards):
    _kind()
