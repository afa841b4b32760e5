"""A PLC with two manipulators behind an OPC UA server, written without code of coaxis: the counterpart of tests/plc_opcua.rs.

    plc_opcua.py [--port 0] [--secure FOLDER] [--fault NAME]

Its nodes are those of docs/opcua.md. It prints on standard output, a line each: `ready PORT`, then each command that it
executes (`executed m1 3 5`: manipulator, sequence number, code) or refuses (`rejected m1 4 101`: with its own code), and each
stop by its watchdog (`watchdog m1`). It echoes each line of its standard input, so that a caller knows that all earlier lines
were printed. It ends when its standard input ends.
With --secure it accepts only Basic256Sha256 and Aes256Sha256RsaPss, signed and encrypted, from the user `coaxis` with the
password in FOLDER/password, and writes its certificate to FOLDER/plc.der. --fault makes it give false answers of one kind.
"""

import argparse
import asyncio
import contextlib
import datetime
import logging
import math
import pathlib
import sys
import threading
import time

from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.server.user_managers import UserManager
from asyncua.crypto.permission_rules import User, UserRole
from cryptography.x509.oid import ExtendedKeyUsageOID

CYCLE_S = 0.01
AXES = "XYZC"
LOWER = [-50.0, -50.0, -50.0, -20.0]
UPPER = [50.0, 50.0, 50.0, 20.0]
SPEED = [25.0, 25.0, 25.0, 10.0]
DISABLED, STANDSTILL, ERROR_STOP, STOPPING, HOMING, MOVING = 1, 2, 3, 4, 5, 6
NONE, ACCEPTED, RUNNING, DONE, REJECTED, ABORTED = range(6)
ENABLE, DISABLE, RESET, HOME, MOVE, HALT = range(1, 7)
CEFACT = "http://www.opcfoundation.org/UA/units/un/cefact"
MILLIMETRE, DEGREE, RADIAN = 5066068, 17476, 4405297


def newer(number, last):
    if number == 0 or last == 0:
        return number != 0
    return 0 < (number - last) % 65535 <= 32767


class Manipulator:
    """The state of one manipulator in the PLC: degrees and millimetres, a step every cycle."""

    def __init__(self, name):
        self.name = name
        self.position = [0.0, 1.0, -2.0, 3.0]
        self.target = list(self.position)
        self.speed = [0.0] * 4
        self.homed = [False] * 4
        self.task = None
        self.powered = False
        self.fault = 0
        self.refusal = 0
        self.acknowledged, self.result = 0, NONE
        self.pulse, self.heard = None, time.monotonic()
        self.watchdog_s = 0.5
        self.until = 0.0

    def hear(self, pulse):
        if pulse != self.pulse:
            self.pulse, self.heard = pulse, time.monotonic()

    def take(self, number, code, mask, targets, speeds, watchdog_ms):
        if not newer(number, self.acknowledged):
            return
        self.acknowledged = number
        self.heard = time.monotonic()
        self.refusal = self.refuses(code, mask, targets, speeds)
        if self.refusal:
            self.result = REJECTED
            print("rejected", self.name, number, self.refusal, flush=True)
            return
        print("executed", self.name, number, code, flush=True)
        self.result = DONE
        self.watchdog_s = min(watchdog_ms, 500) / 1000
        if code == ENABLE:
            self.powered = True
        elif code == DISABLE:
            self.powered, self.task = False, None
        elif code == RESET:
            self.fault = 0
        elif code == HALT:
            self.task = None
            self.target = list(self.position)
        elif code == HOME:
            self.task, self.result, self.mask = HOMING, ACCEPTED, mask
            self.until = time.monotonic() + 0.1
        elif code == MOVE:
            self.task, self.result = MOVING, ACCEPTED
            for axis in range(4):
                if mask >> axis & 1:
                    self.target[axis], self.speed[axis] = targets[axis], speeds[axis]

    def refuses(self, code, mask, targets, speeds):
        if code not in range(ENABLE, HALT + 1):
            return 100
        if code in (HALT, DISABLE, RESET):
            return 0
        if self.fault:
            return 105
        if code in (HOME, MOVE):
            if not self.powered:
                return 103
            if not mask & 15:
                return 108
        if code == MOVE:
            for axis in range(4):
                if mask >> axis & 1:
                    if not LOWER[axis] <= targets[axis] <= UPPER[axis]:
                        return 101
                    if not 0 <= speeds[axis] <= SPEED[axis]:
                        return 102
                    if not self.homed[axis]:
                        return 104
        return 0

    def step(self, dt):
        if self.task is not None and time.monotonic() - self.heard > self.watchdog_s:
            print("watchdog", self.name, flush=True)
            self.task, self.fault, self.result = None, 1, ABORTED
            self.target = list(self.position)
        if self.task is not None and self.result == ACCEPTED:
            self.result = RUNNING
        elif self.task == HOMING and time.monotonic() > self.until:
            self.homed = [homed or bool(self.mask >> axis & 1) for axis, homed in enumerate(self.homed)]
            self.task, self.result = None, DONE
        elif self.task == MOVING:
            for axis in range(4):
                way = self.target[axis] - self.position[axis]
                step = min(abs(way), self.speed[axis] * dt)
                self.position[axis] = self.target[axis] if step == abs(way) else self.position[axis] + math.copysign(step, way)
            if self.position == self.target:
                self.task, self.result = None, DONE

    def state(self):
        if self.fault:
            return ERROR_STOP
        if not self.powered:
            return DISABLED
        return self.task or STANDSTILL


class Plc:
    def __init__(self, server, fault):
        self.server = server
        self.fault = fault
        self.manipulators = {name: Manipulator(name) for name in ("m1", "m2")}
        self.nodes = {}
        self.beat = 0

    async def build(self):
        # Other namespaces come first, so that the index cannot be guessed.
        await self.server.register_namespace("urn:example:first")
        own = await self.server.register_namespace("urn:coaxis:manipulators")
        robotics = await self.server.register_namespace("http://opcfoundation.org/UA/Robotics/")
        await self.server.register_namespace("urn:example:second")
        di = await self.server.register_namespace("http://opcfoundation.org/UA/DI/")
        devices = await self.server.nodes.objects.add_object(di, "DeviceSet")
        cell = await devices.add_object(own, "Cell")
        motion = await cell.add_object(robotics, "MotionDevices")
        for name in self.manipulators:
            device = await motion.add_object(own, name.upper())
            await self.build_axes(name, await device.add_object(robotics, "Axes"), own, di, robotics)
            await self.build_status(name, await device.add_object(own, "Status"), own)
            await self.build_command(name, await device.add_object(own, "Command"), own)

    async def build_axes(self, name, axes, own, di, robotics):
        for index, letter in enumerate(AXES):
            axis = await axes.add_object(own, letter)
            parameters = await axis.add_object(di, "ParameterSet")
            actual = await parameters.add_variable(robotics, "ActualPosition", 0.0, ua.VariantType.Double)
            await actual.add_property(0, "EURange", ua.Range(LOWER[index], UPPER[index]))
            code = DEGREE if letter == "C" else MILLIMETRE
            if self.fault == "radians" and letter == "C":
                code = RADIAN
            unit = ua.EUInformation(CEFACT, code, ua.LocalizedText("unit"), ua.LocalizedText("unit"))
            await actual.add_property(0, "EngineeringUnits", unit)
            await parameters.add_variable(robotics, "ActualSpeed", 0.0, ua.VariantType.Double)
            self.nodes[name, letter] = actual

    async def build_status(self, name, status, own):
        kinds = ua.VariantType
        self.status = {
            "Snapshot": (kinds.UInt32, 0),
            "Heartbeat": (kinds.UInt16, 0),
            "State": (kinds.UInt16, DISABLED),
            "Mode": (kinds.UInt16, 2),
            "Safety": (kinds.UInt16, 15),
            "AckSequence": (kinds.UInt16, 0),
            "Result": (kinds.UInt16, 0),
            "FaultCode": (kinds.UInt32, 0),
            "AxisStates": (kinds.UInt16, [DISABLED] * 4),
            "Homed": (kinds.Boolean, [False] * 4),
            "InPosition": (kinds.Boolean, [True] * 4),
            "AxisFaults": (kinds.Boolean, [False] * 4),
            "LimitsHit": (kinds.Boolean, [False] * 4),
            "CommandedPositions": (kinds.Double, [0.0] * 4),
            "MaxVelocities": (kinds.Double, SPEED),
        }
        for word, (kind, value) in self.status.items():
            if self.fault == "missing" and word == "Homed":
                continue
            self.nodes[name, word] = await status.add_variable(own, word, value, kind)

    async def build_command(self, name, command, own):
        kinds = ua.VariantType
        words = {
            "Heartbeat": (kinds.UInt16, 0),
            "Fence": (kinds.UInt64, 0),
            "WatchdogMs": (kinds.UInt32, 0),
            "Code": (kinds.UInt16, 0),
            "Mask": (kinds.UInt16, 0),
            "Targets": (kinds.Double, [0.0] * 4),
            "Velocities": (kinds.Double, [0.0] * 4),
            "Sequence": (kinds.UInt16, 0),
        }
        for word, (kind, value) in words.items():
            node = await command.add_variable(own, word, value, kind)
            if not (self.fault == "readonly" and word == "Targets"):
                await node.set_writable()
            self.nodes[name, "Command", word] = node

    async def put(self, name, word, value, kind):
        node = self.nodes.get((name, word))
        if node is None:
            return
        stamp = datetime.datetime.now(datetime.timezone.utc)
        status = ua.StatusCode(ua.StatusCodes.Good)
        if self.fault == "uncertain" and word == "Y":
            status = ua.StatusCode(ua.StatusCodes.UncertainLastUsableValue)
        data = ua.DataValue(ua.Variant(value, kind), status, SourceTimestamp=stamp, ServerTimestamp=stamp)
        await self.server.write_attribute_value(node.nodeid, data)

    async def command(self, name):
        async def value(word):
            return await self.nodes[name, "Command", word].read_value()

        manipulator = self.manipulators[name]
        manipulator.hear(await value("Heartbeat"))
        number = await value("Sequence")
        if number != manipulator.acknowledged:
            words = ("Code", "Mask", "Targets", "Velocities", "WatchdogMs")
            manipulator.take(number, *[await value(word) for word in words])

    async def publish(self, name):
        one, kinds = self.manipulators[name], ua.VariantType
        if self.fault != "torn":
            await self.put(name, "Snapshot", 2 * self.beat + 1 & 0xFFFFFFFF, kinds.UInt32)
        state = one.state()
        values = {
            "State": state,
            "AckSequence": one.acknowledged,
            "Result": one.result,
            "FaultCode": one.fault or one.refusal,
            "AxisStates": [state] * 4,
            "Homed": one.homed,
            "InPosition": [p == t for p, t in zip(one.position, one.target)],
            "CommandedPositions": one.position,
        }
        if self.fault != "frozen":
            values["Heartbeat"] = self.beat & 0xFFFF
        for word, value in values.items():
            await self.put(name, word, value, self.status[word][0])
        for letter, value in zip(AXES, one.position):
            await self.put(name, letter, math.nan if self.fault == "nan" and letter == "Z" else value, kinds.Double)
        await self.put(name, "Snapshot", 2 * self.beat + (3 if self.fault == "torn" else 2) & 0xFFFFFFFF, kinds.UInt32)

    async def run(self):
        last = time.monotonic()
        while True:
            await asyncio.sleep(CYCLE_S)
            now = time.monotonic()
            self.beat += 1
            for name, manipulator in self.manipulators.items():
                await self.command(name)
                # After it was frozen it does not jump: missed cycles are not executed later.
                manipulator.step(min(now - last, 5 * CYCLE_S))
                await self.publish(name)
            last = now


class OneUser(UserManager):
    def __init__(self, password):
        self.password = password

    def get_user(self, iserver, username=None, password=None, certificate=None):
        return User(role=UserRole.User, name=username) if (username, password) == ("coaxis", self.password) else None


async def secure(server, folder):
    key, certificate = folder / "plc-key.pem", folder / "plc.der"
    await setup_self_signed_certificate(
        key, certificate, "urn:coaxis:test:plc", "localhost", [ExtendedKeyUsageOID.SERVER_AUTH], {"commonName": "plc"}
    )
    policies = ua.SecurityPolicyType
    server.set_security_policy([policies.Basic256Sha256_SignAndEncrypt, policies.Aes256Sha256RsaPss_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])
    await server.load_certificate(str(certificate))
    await server.load_private_key(str(key))


async def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--secure", type=pathlib.Path)
    parser.add_argument(
        "--fault", choices=["radians", "missing", "readonly", "uncertain", "nan", "torn", "frozen"], default=None
    )
    arguments = parser.parse_args()
    logging.disable(logging.CRITICAL)
    users = OneUser((arguments.secure / "password").read_text().strip()) if arguments.secure else None
    server = Server(user_manager=users) if users else Server()
    await server.init()
    await server.set_application_uri("urn:coaxis:test:plc")
    server.set_endpoint(f"opc.tcp://127.0.0.1:{arguments.port}")
    if arguments.secure:
        await secure(server, arguments.secure)
    else:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    plc = Plc(server, arguments.fault)
    await plc.build()
    async with server:
        print("ready", arguments.port, flush=True)
        loop, ended = asyncio.get_running_loop(), asyncio.Event()

        def wait_for_the_end():
            for line in sys.stdin:
                print(line.strip(), flush=True)
            loop.call_soon_threadsafe(ended.set)

        threading.Thread(target=wait_for_the_end, daemon=True).start()
        cycle = asyncio.create_task(plc.run())
        await asyncio.wait([cycle, asyncio.create_task(ended.wait())], return_when=asyncio.FIRST_COMPLETED)
        cycle.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await cycle


asyncio.run(main())
