"""A host of FMI 3.0 units in Python's standard library alone: what a simulator of systems calls.

`python -I -S fmi_host.py UNIT.fmu STEPS` runs a unit in a Python that finds no other library."""

import ctypes
import json
import platform
import sys
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

OK, DISCARD, ERROR = 0, 2, 3
LOG = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
DOUBLES = ctypes.POINTER(ctypes.c_double)


class Unit:
    """An unpacked unit, from which instances are made."""

    def __init__(self, path):
        self.folder = tempfile.TemporaryDirectory()
        with zipfile.ZipFile(path) as archive:
            archive.extractall(self.folder.name)
        (library,) = Path(self.folder.name, "binaries").rglob("*.*")
        self.library = ctypes.CDLL(str(library))
        self.description = ElementTree.parse(Path(self.folder.name, "modelDescription.xml"))
        self.token = self.description.getroot().get("instantiationToken").encode()
        variables = self.description.iter("Float64")
        self.references = {v.get("name"): int(v.get("valueReference")) for v in variables}


class Instance:
    """An instance for co-simulation; `messages`: what it has logged."""

    def __init__(self, unit, start=True, time=0.0, **values):
        self.unit, self.messages = unit, []
        self.log = LOG(lambda _, status, kind, text: self.messages.append(text.decode()))
        make = unit.library.fmi3InstantiateCoSimulation
        make.restype = ctypes.c_void_p
        none = ctypes.c_void_p(None)
        false, count = ctypes.c_bool(False), ctypes.c_size_t(0)
        flags = [false] * 4
        found = make(b"one", unit.token, b"", *flags, none, count, none, self.log, none)
        assert found
        self.one = ctypes.c_void_p(found)
        self.time = time
        if start:
            self.begin(**values)

    def begin(self, **values):
        off, zero = ctypes.c_bool(False), ctypes.c_double(0.0)
        self("EnterInitializationMode", off, zero, ctypes.c_double(self.time), off, zero)
        for name, value in values.items():
            assert self.set(name.replace("_", " "), value) == OK
        assert self("ExitInitializationMode") == OK

    def __call__(self, name, *arguments):
        return getattr(self.unit.library, f"fmi3{name}")(self.one, *arguments)

    def _numbers(self, names):
        places = (ctypes.c_uint32 * len(names))(*(self.unit.references[n] for n in names))
        return places, ctypes.c_size_t(len(names)), (ctypes.c_double * len(names))()

    def set(self, name, value):
        places, count, values = self._numbers([name])
        values[0] = value
        return self("SetFloat64", places, count, values, count)

    def get(self, *names):
        places, count, values = self._numbers(names)
        assert self("GetFloat64", places, count, values, count) == OK
        return list(values)

    def step(self, length):
        flags = [ctypes.c_bool() for _ in range(3)]
        last = ctypes.c_double()
        numbers = ctypes.c_double(self.time), ctypes.c_double(length)
        passed = [ctypes.byref(x) for x in (*flags, last)]
        status = self("DoStep", *numbers, ctypes.c_bool(True), *passed)
        self.time, self.early = last.value, flags[2].value
        return status

    def slope(self, name, *outputs):
        unknown, count, values = self._numbers(outputs)
        known, one, seed = self._numbers([name])
        seed[0] = 1.0
        found = self(
            "GetDirectionalDerivative", unknown, count, known, one, seed, one, values, count
        )
        assert found == OK
        return list(values)

    def save(self):
        """The state as bytes."""
        state, size = ctypes.c_void_p(None), ctypes.c_size_t()
        assert self("GetFMUState", ctypes.byref(state)) == OK
        self("SerializedFMUStateSize", state, ctypes.byref(size))
        raw = (ctypes.c_uint8 * size.value)()
        assert self("SerializeFMUState", state, raw, size) == OK
        self("FreeFMUState", ctypes.byref(state))
        return bytes(raw)

    def restore(self, raw, time):
        state = ctypes.c_void_p(None)
        count = ctypes.c_size_t(len(raw))
        assert self("DeserializeFMUState", raw, count, ctypes.byref(state)) == OK
        assert self("SetFMUState", state) == OK
        self.time = time


if __name__ == "__main__":
    instance = Instance(Unit(sys.argv[1]))
    for _ in range(int(sys.argv[2])):
        assert instance.step(1e-3) == OK
    names = [
        v.get("name")
        for v in instance.unit.description.iter("Float64")
        if v.get("causality") == "output"
    ]
    foreign = sorted({"jax", "numpy", "jaxclear"} & set(sys.modules))
    print(
        json.dumps({"values": instance.get(*names), "foreign": foreign, "on": platform.machine()})
    )
