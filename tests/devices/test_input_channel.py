"""Channels at inputs of a drive: conversion, limits, and what a rig file may not say."""

import pytest

from labrig.devices.input_channel import InputChannel
from labrig.errors import FileFormatError
from tests.devices.rigs import simulated_rig

FORCE = InputChannel(source="analog-1", unit="N", units_per_volt=4.0, zero_v=0.5, limits=(-5.0, 5.0))
DOOR = InputChannel(source="general-A", expected=True)


def test_a_voltage_becomes_a_value_in_the_unit_of_the_sensor() -> None:
    """4 N/V above 0.5 V: 1.75 V are 5 N; its column has the unit."""
    assert FORCE.convert(1.75) == 5.0
    assert (FORCE.column("needle_force"), DOOR.column("door")) == ("input_needle_force_N", "input_door")


def test_a_value_beyond_its_limits_is_told_with_both() -> None:
    """A number has limits, a switch an expected state; on the limit is within."""
    force, door = (
        FORCE.find_excess("needle_force", "insertion", 5.1),
        DOOR.find_excess("door", "linear", False),
    )
    assert force is not None
    assert force.message == (
        "input needle_force is 5.1 N, limits [-5, 5] N (analog-1 of the drive of axis insertion)"
    )
    assert door is not None
    assert door.message == "input door is off, expected on (general-A of the drive of axis linear)"
    assert FORCE.find_excess("needle_force", "insertion", 5.0) is None
    assert DOOR.find_excess("door", "linear", True) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("force: {source: analog-1, unit: N}", "units_per_volt is missing or zero for analog-1"),
        ("force: {source: analog-1, units_per_volt: 4}", "unit is missing or zero"),
        ("door: {source: general-A, limits: [0, 1]}", "general-A is a digital input"),
        ("force: {source: analog-1, unit: N, units_per_volt: 4, expected: true}", "is an analog input"),
        ("force: {source: analog-1, unit: N, units_per_volt: 4, limits: [5, -5]}", "the lower one first"),
        ("force: {source: analog-9, unit: N, units_per_volt: 4}", "analog-9 is no input of this drive"),
        ("Door: {source: general-A}", "Door"),
        ("shut: {source: general-A}", "input shut is also one of axis insertion"),
    ],
)
def test_a_rig_file_with_an_impossible_channel_is_refused(text: str, words: str) -> None:
    """Each problem names the key; two axes share no name of an input, by which records tell channels apart."""
    with pytest.raises(FileFormatError, match=words):
        simulated_rig(f"axes.linear.inputs={{{text}}}", "axes.insertion.inputs={shut: {source: general-A}}")
