"""Files of one tap as oscilloscopes, loggers, phones, sensors and analysers write them, by their own descriptions.

Every file holds the same tap: a stylus of 0.12 kg at 0.2 m/s on a spring and damper, contact at 0.1 s. `TAP` has what
a reader must find. Each kind follows what its maker's manual or an export shows: names, units, remarks, separators.
"""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from tests.benches.brought_further import FURTHER
from tests.benches.tap_formats import (
    ONSET_S,
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
    wave,
    workbook,
)
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G

FILES: list[Brought] = []


def _add(name: str, data: str | bytes, lacks: str = "", right: Mapping[str, Any] | None = None) -> None:
    FILES.append(Brought(name, data if isinstance(data, bytes) else data.encode(), lacks, right or {}))


def _scopes() -> None:
    volts = {"CH1": "V @ 100 mV/g"}
    _add(
        "tektronix_mdo.csv",
        "Model,MDO3024\nFirmware Version,1.14\n\nWaveform Type,ANALOG\nPoint Format,Y\nHorizontal Units,s\n"
        "Horizontal Scale,0.04\nHorizontal Delay,0\nSample Interval,0.0001\nRecord Length,3000\n"
        "Gating,0.0% to 100.0%\nProbe Attenuation,1\nVertical Units,V\nVertical Offset,0\nVertical Scale,0.5\n"
        "Vertical Position,0\n,\n,\n,\nLabel,\nTIME,CH1\n" + rows(TIMES_S, V, form="{:.9e}"),
        "units",
        {"units": volts},
    )
    notes = [
        "Record Length,3.000000e+03",
        "Sample Interval,1.000000e-04",
        "Trigger Point,1.00000e+03",
        ",",
        ",",
        ",",
        "Source,CH1",
        "Vertical Units,V",
        "Vertical Scale,5.000000e-01",
        "Vertical Offset,0.000000e+00",
        "Horizontal Units,s",
        "Horizontal Scale,4.000000e-02",
        "Pt Fmt,Y",
        "Yzero,0.000000e+00",
        "Probe Atten,1.000000e+00",
        "Model Number,TBS1052B",
        "Serial Number,C012345",
        "Firmware Version,FV:v4.06",
    ]
    lines = [*notes, *[","] * (TIMES_S.size - len(notes))]
    _add(
        "tektronix_tbs.csv",
        "".join(f"{n},,{t:017.12f},{v:10.5f},\n" for n, t, v in zip(lines, TIMES_S, V, strict=True)),
        "units",
        {"units": volts},
    )
    counted = "".join(f"{k},{v:.9g},\n" for k, v in enumerate(V))
    _add(
        "rigol_ds1000.csv",
        f"X,CH1,Start,Increment,\nSequence,Volt,0.0e+00,1.0e-04\n{counted}",
        "units",
        {"units": volts},
    )
    _add(
        "rigol_mso5000.csv",
        "Time(s),CH1(V),t0 = 0.0, tInc = 0.0001,\n" + rows(TIMES_S, V, end=",,\n"),
        "units",
        {"units": volts},
    )
    _add(
        "rigol_two.csv",
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,0.0e+00,1.0e-04\n"
        + "".join(f"{k},{v:.9g},{0.01:.3g},\n" for k, v in enumerate(V)),
        "units",
        {"units": volts},
    )
    _add(
        "siglent_sds.csv",
        "Record Length,Analog:3000\nSample Interval,Analog:1.000000E-04\nVertical Units,CH1:V\n"
        "Vertical Scale,CH1:0.50\n"
        "Vertical Offset,CH1:0.00\nHorizontal Units,s\nHorizontal Scale,0.02\nModel Number,SDS1104X-E\n"
        "Serial Number,SDSMMFCD4R0000\nSoftware Version,8.1.6.1.37R9\nSource,CH1\nSecond,Value\n"
        + rows(TIMES_S, V, form="{:.9f}"),
        "units",
        {"units": volts},
    )
    _add("siglent_old.csv", "Source,CH1\nSecond,Volt\n" + rows(TIMES_S, V), "units", {"units": volts})
    _add(
        "keysight_infiniivision.csv",
        "x-axis,1\nsecond,Volt\n" + rows(TIMES_S, V, form="{:+.9E}"),
        "units",
        {"units": {"1": "V @ 100 mV/g"}},
    )
    _add(
        "keysight_two.csv",
        "x-axis,1,2\nsecond,Volt,Volt\n" + rows(TIMES_S, V, 0 * V, form="{:+.9E}"),
        "units",
        {"units": {"1": "V @ 100 mV/g"}},
    )
    _add(
        "lecroy.csv",
        "LECROYWS3054,12345,Waveform\nSegments,1,SegmentSize,3000\nSegment,TrigTime,TimeSinceSegment1\n"
        "#1,05-Mar-2024 14:11:02,0\nTime,Ampl\n" + rows(TIMES_S, V, form="{:.9e}"),
        "units",
        {"units": {"Time": "s", "Ampl": "V @ 100 mV/g"}},
    )
    head = "Time,Channel A\n(ms),(mV)\n\n"
    _add("picoscope.csv", head + rows(1e3 * TIMES_S, 1e3 * V), "units", {"units": {"Channel A": "mV @ 100 mV/g"}})
    _add(
        "picoscope_german.csv",
        "Zeit;Kanal A\n(ms);(mV)\n\n" + rows(1e3 * TIMES_S, 1e3 * V, mark=";").replace(".", ","),
        "units",
        {"units": {"Kanal A": "mV @ 100 mV/g"}},
    )
    _add("picoscope_probe.csv", "Time,Channel A\n(ms),(g)\n\n" + rows(1e3 * TIMES_S, TAP_M_S2 / G))
    _add(
        "picoscope.mat",
        mat(A=V.astype("f4")[:, None], Tstart=0.0, Tinterval=1e-4, Length=3000.0, ExtraSamples=0.0),
        "units",
        {"units": {"A": "V @ 100 mV/g"}},
    )
    _add(
        "waveforms.csv",
        "#Digilent WaveForms Oscilloscope Acquisition\n#Device Name: Discovery2\n#Serial Number: SN:210321A\n"
        "#Date Time: 2024-03-05 14:11:02.334\n#Sample rate: 10000Hz\n#Samples: 3000\n#Trigger: Source: Channel 1\n"
        "#Channel 1: Range: 500 mV/div Offset: 0 V\n\nTime (s),Channel 1 (V)\n" + rows(TIMES_S, V),
        "units",
        {"units": {"Channel 1": "V @ 100 mV/g"}},
    )
    _add(
        "saleae.csv",
        "Time [s],Channel 0\n" + rows(TIMES_S, V, form="{:.9f}"),
        "units",
        {"units": {"Channel 0": "V @ 100 mV/g"}},
    )


def _phones() -> None:
    x, y, z = axes()
    total = np.sqrt(x**2 + y**2 + z**2)
    head = (
        '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)",'
        '"Absolute acceleration (m/s^2)"\n'
    )
    _add("phyphox.csv", head + rows(TIMES_S, x, y, z, total, form="{:.9E}"))
    linear = head.replace("Acceleration x", "Linear Acceleration x").replace(
        "Acceleration y", "Linear Acceleration y"
    )
    linear = linear.replace("Acceleration z", "Linear Acceleration z").replace(",", ";")
    commas = rows(TIMES_S, x, y, z - G, total, mark=";", form="{:.9E}").replace(".", ",")
    _add("phyphox_linear_comma.csv", linear + commas)
    _add("phyphox_tabs.csv", head.replace(",", "\t") + rows(TIMES_S, x, y, z, total, mark="\t", form="{:.9E}"))
    _add(
        "physics_toolbox_g.csv",
        "time,gFx,gFy,gFz,TgF\n" + rows(TIMES_S, x / G, y / G, z / G, total / G),
        "units",
        {"units": {"time": "s"}},
    )
    _add(
        "physics_toolbox_a.csv",
        "time,ax,ay,az,aT\n" + rows(clock("{hour}"), x, y, z, total),
        "units",
        {"units": {"acceleration": "m/s^2"}},
    )
    _add(
        "androsensor.csv",
        "ACCELEROMETER X (m/s²);ACCELEROMETER Y (m/s²);ACCELEROMETER Z (m/s²);Time since start in ms ;"
        "YYYY-MO-DD HH-MI-SS_SSS\n" + rows(x, y, z, 1e3 * TIMES_S, clock("{day} 14-11-02_{hour}"), mark=";"),
    )
    _add(
        "matlab_mobile.csv",
        "Timestamp,X,Y,Z\n" + rows(clock("{d}-Mar-{y} {hour}"), x, y, z),
        "units",
        {"units": {"acceleration": "m/s^2"}},
    )
    _add(
        "sensor_logger.csv",
        "seconds_elapsed,z,y,x\n" + rows(TIMES_S, z, y, x),
        "units",
        {"units": {"acceleration": "m/s^2"}},
    )


def _boards() -> None:
    x, y, z = axes()
    counts = [np.round(each / G * 2048) for each in (x, y, z)]
    us = np.round(1e6 * TIMES_S)
    _add(
        "arduino_us_mg.txt", "t_us ax_mg ay_mg az_mg\n" + rows(us, *(1e3 * each / G for each in (x, y, z)), mark=" ")
    )
    _add(
        "arduino_counts.csv",
        "time_us,ax,ay,az\n" + rows(us, *counts, form="{:.0f}"),
        "units",
        {"units": {"acceleration": "LSB @ 2048 LSB/g"}},
    )
    _add("arduino_bare.csv", rows(TIMES_S, TAP_M_S2 / G), "columns", {"columns": ["time_s", "acceleration_g"]})
    _add(
        "arduino_bare_tabs.txt",
        rows(np.round(1e6 * TIMES_S), TAP_M_S2, mark="\t", form="{:.12g}"),
        "columns",
        {"columns": ["time [us]", "acc [m/s^2]"]},
    )
    _add("arduino_millis.csv", "millis,acc (g)\n" + rows(1e3 * TIMES_S, TAP_M_S2 / G))
    _add(
        "arduino_plotter.txt",
        "".join(f"t_us:{t:.0f},acc_g:{a:.6f}\n" for t, a in zip(us, TAP_M_S2 / G, strict=True)),
    )
    _add(
        "arduino_monitor.txt",
        "".join(
            f"14:11:02.{k // 10:03d} -> {t:.0f},{a:.6f}\n"
            for k, (t, a) in enumerate(zip(us, TAP_M_S2 / G, strict=True))
        ),
        "columns",
        {"columns": ["time [us]", "acc [g]"]},
    )
    _add(
        "klipper_adxl.csv",
        "#time,accel_x,accel_y,accel_z\n" + rows(1532.4 + TIMES_S, 1e3 * x, 1e3 * y, 1e3 * z, form="{:.6f}"),
        "units",
        {"units": {"time": "s", "acceleration": "mm/s^2"}},
    )
    groups = np.arange(TIMES_S.size) // 32 * 32 / RATE_HZ
    _add(
        "fifo.csv",
        "time [s],acc [g]\n" + rows(groups, TAP_M_S2 / G, form="{:.6f}"),
        "rate_Hz",
        {"rate_Hz": 10_000.0},
    )
    _add("no_times.csv", "acc_g\n" + rows(TAP_M_S2 / G), "rate_Hz", {"rate_Hz": 10_000.0})
    _add(
        "openlog_artemis.csv",
        "rtcDate,rtcTime,aX,aY,aZ,imu_degC\n"
        + rows(["03/05/2024"] * TIMES_S.size, clock("{hour}"), *(1e3 * each / G for each in (x, y, z)), 25 + 0 * x),
        "units",
        {"units": {"acceleration": "mg"}},
    )


def _loggers() -> None:
    x, y, z = axes()
    _add("iso_dates.csv", "Time,Acc (g)\n" + rows(clock("{day} {hour}"), TAP_M_S2 / G))
    _add(
        "time_of_day.csv",
        "Date;Time;Acc (g)\n" + rows(clock("{d}.{m}.{y}"), clock("{hour}"), TAP_M_S2 / G, mark=";").replace(".", ","),
    )
    _add(
        "gcdc_x16.csv",
        ";Title, http://www.gcdataconcepts.com, X16-1D, Analog Dev ADXL345\n;Version, 1110, Build date,"
        " Jan 16 2017,  SN:CCDC1016\n"
        ";Start_time, 2024-03-05, 14:11:02.000\n;Temperature, 25.00, deg C,  Vbat, 3990, mv\n;SampleRate,"
        " 10000,Hz\n;Deadband, 0, counts\n"
        ";Headers, time,Ax,Ay,Az\n"
        + rows(TIMES_S, *(np.round(each / G * 2048) for each in (x, y, z)), form="{:.6g}"),
        "units",
        {"units": {"time": "s", "acceleration": "LSB @ 2048 LSB/g"}},
    )
    _add(
        "msr.csv",
        "*CREATOR\nMSR;2.1\n*STARTTIME\n2024-03-05;14:11:02\n*MODUL\nMSR;165\n*CHANNEL\nTIME;ACC x;ACC y;"
        "ACC z\ns;G;G;G\n*DATA\n" + rows(TIMES_S, x / G, y / G, z / G, mark=";"),
    )
    _add(
        "dewesoft.txt",
        "Data info\n\nFile name: tap.dxd\nStart time: 3/5/2024 2:11:02 PM\nNumber of channels: 1\n"
        "Sample rate: 10000 Hz\n\nTime (s)\tAcc (g)\n" + rows(TIMES_S, TAP_M_S2 / G, mark="\t"),
    )
    _add("sample_rate_head.csv", "Sample Rate,10000,Hz\nSensor,352C33\n\nAcceleration (g)\n" + rows(TAP_M_S2 / G))
    _add(
        "multirate.csv",
        "Time [s],Acc [g],Pos [mm]\n"
        + "".join(
            f"{t:.5f},{a:.6f},{-200 * (t - ONSET_S) if k % 10 == 0 else ''}\n"
            for k, (t, a) in enumerate(zip(TIMES_S, TAP_M_S2 / G, strict=True))
        ),
    )
    _add(
        "cp1252.csv",
        ("Zeit (µs);Beschleunigung (m/s²)\n" + rows(1e6 * TIMES_S, TAP_M_S2, mark=";").replace(".", ",")).encode(
            "cp1252"
        ),
    )
    _add("utf16.csv", ("Time (ms)\tAcc (m/s²)\n" + rows(1e3 * TIMES_S, TAP_M_S2, mark="\t")).encode("utf-16"))
    _add(
        "metadata.csv", "Test rig 3\nOperator: me\nsensor 352C33\n\nTime (s),Acc (g)\n" + rows(TIMES_S, TAP_M_S2 / G)
    )
    _add(
        "two_sensors.csv",
        "Time (s),Acc tip (g),Acc table (g)\n" + rows(TIMES_S, TAP_M_S2 / G, 0.01 * x),
        "columns",
        {"columns": ["Time (s)", "Acc tip (g)", "-"]},
    )
    _add("named_by_unit.csv", "Time (s),Dev1/ai0 (g)\n" + rows(TIMES_S, TAP_M_S2 / G))
    _add(
        "labview.lvm",
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        "Decimal_Separator\t.\nMulti_Headings\tNo\n"
        "X_Columns\tOne\nTime_Pref\tRelative\nOperator\tlab\nDate\t2024/03/05\nTime\t14:11:02.33\n"
        "***End_of_Header***\t\n\t\n"
        "Channels\t1\t\nSamples\t3000\t\nDate\t2024/03/05\t\nTime\t14:11:02.33\t\nY_Unit_Label\tg\t\n"
        "X_Dimension\tTime\t\n"
        "X0\t0.0000000000000000E+0\t\nDelta_X\t1.000000E-4\t\n***End_of_Header***\t\t\n"
        "X_Value\tAcceleration\tComment\n" + rows(TIMES_S, TAP_M_S2 / G, mark="\t"),
    )
    _add(
        "labview_no_x.lvm",
        "LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\tNo\n***End_of_Header***\t\n\t\nChannels\t1\t\n"
        "Y_Unit_Label\tg\t\n"
        "Delta_X\t1.000000E-4\t\n***End_of_Header***\t\t\nX_Value\tAcceleration\tComment\n"
        + "".join(f"\t{a:.9g}\n" for a in TAP_M_S2 / G),
    )


def _analysers() -> None:
    _add("variables.mat", mat(time_s=TIMES_S, acc_g=TAP_M_S2 / G))
    _add("rate.mat", mat(acc=TAP_M_S2 / G, Fs=RATE_HZ), "units", {"units": {"acc": "g"}})
    _add("axes.mat", mat(t=TIMES_S, acc=np.column_stack(axes())), "units", {"units": {"t": "s", "acc": "m/s^2"}})
    x_values = {"quantity": {"label": "s"}, "start_value": 0.0, "increment": 1e-4, "number_of_values": 3000.0}
    y_values = {"quantity": {"label": "g"}, "values": TAP_M_S2 / G}
    _add("testlab.mat", mat(Signal={"x_values": x_values, "y_values": y_values}))
    _add("logger.h5", hdf5({"log/time_s": (TIMES_S, ""), "log/acc": (TAP_M_S2 / G, "g")}))
    times_and_acc = {"time": (TIMES_S[None], ""), "acc": (TAP_M_S2[None] / G, "")}
    _add("v73.mat", hdf5(times_and_acc, user_block=512), "units", {"units": {"time": "s", "acc": "g"}})
    step = {"wf_increment": 1e-4}
    _add("waveform.tdms", tdms({"acc": (TAP_M_S2 / G, "g")}, step))
    _add("named.tdms", tdms({"cDAQ1Mod1/ai0": (TAP_M_S2, "m/s^2")}, step))
    _add("volts.tdms", tdms({"Voltage_0": (V, "V")}, step), "units", {"units": {"Voltage_0": "V @ 100 mV/g"}})
    _add(
        "sheet.xlsx",
        workbook(
            [
                ("Logger X7", ""),
                ("Time [ms]", "Acc [g]"),
                *zip((1e3 * TIMES_S).tolist(), (TAP_M_S2 / G).tolist(), strict=True),
            ]
        ),
    )
    _add(
        "sheet_no_units.xlsx",
        workbook([("time", "acc [g]"), *zip(TIMES_S.tolist(), (TAP_M_S2 / G).tolist(), strict=True)]),
        "units",
        {"units": {"time": "s"}},
    )
    stream = io.BytesIO()
    np.savez(stream, t_s=TIMES_S, acc_m_s2=TAP_M_S2)
    _add("arrays.npz", stream.getvalue())
    stream = io.BytesIO()
    np.savez(stream, x0=TIMES_S, x1=TAP_M_S2)
    _add("unnamed.npz", stream.getvalue(), "units", {"units": {"x0": "s", "x1": "m/s^2"}})


def _universal() -> None:
    _add("time_g.uff", universal(("g", "12"), values=TAP_M_S2 / G))
    _add("time_binary.uff", universal(("m/s^2", "12"), binary=True))
    _add("two_responses.unv", universal(("m/s^2", "12"), ("m/s^2", "12")), "channel", {"channel": 1})
    _add("time_no_label.uff", universal(("NONE", "12")), "units", {"units": {"acceleration": "m/s^2"}})
    _add("time_volts.u58", universal(("V", "0"), values=V), "units", {"units": {"acceleration": "V @ 100 mV/g"}})


def _sounds() -> None:
    full = {"full_scale_m_s2": 490.3}
    samples = TAP_M_S2 / 490.3
    _add("audacity_float.wav", wave(samples, "f4"), "full_scale_m_s2", full)
    _add("audacity_16.wav", wave(samples, "i2"), "full_scale_m_s2", full)
    _add("audacity_24.wav", wave(samples, "i3"), "full_scale_m_s2", full)


for _kind in (_scopes, _phones, _boards, _loggers, _analysers, _universal, _sounds):
    _kind()
FILES += FURTHER
