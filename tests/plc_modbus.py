"""An independent PLC on Modbus TCP, written with pymodbus from docs/modbus.md alone, without code of coaxis.

It works like a PLC: the server only transfers registers, and a cycle every 10 ms reads the command block, moves the axes and
writes the status block. Three devices: m1 at base 0, m2 at 256, a stage at 512. Axes start without a reference; every
hundredth cycle leaves the status inconsistent for a moment.

    python tests/plc_modbus.py          prints READY and the port, then one line for each command that it executed
"""

import asyncio
import math
import struct
import sys
import time

from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

STATUS, COMMAND, STEP, DEVICES = 0, 128, 256, 3
DISABLED, STANDSTILL, ERROR_STOP, STOPPING, HOMING, DISCRETE = 1, 2, 3, 4, 5, 6
NONE, ACCEPTED, RUNNING, DONE, REJECTED, ABORTED = range(6)
ENABLE, DISABLE, RESET, HOME, MOVE, HALT = range(1, 7)
CYCLE_S = 0.010
ACCELERATION = 400.0
MANIPULATOR = [(-200.0, 200.0, 50.0)] * 3 + [(-180.0, 180.0, 30.0)]
RAIL = [(0.0, 1200.0, 200.0)] + [(-1.0, 1.0, 1.0)] * 3
FAULT_WATCHDOG, REFUSED_LIMIT, REFUSED_SPEED, REFUSED_STATE, REFUSED_CRC, REFUSED_CODE = 11, 51, 52, 53, 54, 55

registers = [0] * (STEP * DEVICES)


def crc16(words):
    crc = 0xFFFF
    for byte in struct.pack(f">{len(words)}H", *words):
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def floats(words):
    return list(struct.unpack(f">{len(words) // 2}f", struct.pack(f">{len(words)}H", *words)))


def newer(sequence, last):
    """On the circle of 1 to 65535, up to half of it ahead."""
    return sequence != 0 and (last == 0 or 0 < (sequence - last) % 65535 <= 32767)


class Axis:
    def __init__(self, lower, upper, top_speed):
        self.lower, self.upper, self.top_speed = lower, upper, top_speed
        self.position = min(max(0.0, lower), upper)
        self.target, self.speed, self.velocity, self.homed = self.position, 0.0, 0.0, False

    def rests(self):
        return self.velocity == 0.0 and self.position == self.target

    def brake(self):
        """A new target as near as the deceleration allows."""
        way = self.velocity * abs(self.velocity) / (2.0 * ACCELERATION)
        self.target, self.speed = self.position + way, abs(self.velocity)

    def move(self, dt):
        left = self.target - self.position
        wanted = math.copysign(min(self.speed, math.sqrt(2.0 * ACCELERATION * abs(left))), left)
        change = ACCELERATION * dt
        self.velocity += min(max(wanted - self.velocity, -change), change)
        if abs(left) <= abs(self.velocity) * dt or (abs(left) < 1e-6 and abs(self.velocity) <= change):
            self.position, self.velocity = self.target, 0.0
        else:
            self.position += self.velocity * dt


class Device:
    def __init__(self, name, base, axes):
        self.name, self.base = name, base
        self.axes = [Axis(*axis) for axis in axes]
        self.state, self.fault, self.refusal = DISABLED, 0, 0
        self.sequence, self.result, self.cycles = 0, NONE, 0
        self.echo, self.heard, self.watchdog_s, self.home_at, self.then = 0, 0.0, 0.5, 0.0, STANDSTILL

    def cycle(self, now, dt):
        command = registers[self.base + COMMAND : self.base + COMMAND + 24]
        if command[0] != self.echo:
            self.echo, self.heard = command[0], now
        if newer(command[23], self.sequence):
            self.heard = now
            self.take(command, now)
        if self.state in (HOMING, DISCRETE) and now - self.heard > self.watchdog_s:
            self.fault, self.result = FAULT_WATCHDOG, ABORTED
            self.stop(ERROR_STOP)
        for axis in self.axes:
            axis.move(dt)
        self.arrive(now)
        self.cycles += 1

    def arrive(self, now):
        rest = all(axis.rests() for axis in self.axes)
        if self.state == DISCRETE and rest:
            self.state, self.result = STANDSTILL, DONE
        elif self.state == HOMING and now >= self.home_at:
            for index, axis in enumerate(self.axes):
                axis.homed = axis.homed or bool(self.mask >> index & 1)
            self.state, self.result = STANDSTILL, DONE
        elif self.state == STOPPING and rest:
            self.state = self.then
            if self.result in (ACCEPTED, RUNNING):
                self.result = DONE

    def stop(self, then):
        for axis in self.axes:
            axis.brake()
        self.state, self.then = STOPPING, then

    def take(self, command, now):
        self.sequence, code, self.mask = command[23], command[1], command[2]
        targets, speeds = floats(command[4:12]), floats(command[12:20])
        self.refusal = self.why_not(command, code, targets, speeds)
        if self.refusal:
            self.result = REJECTED
            return
        self.result, self.watchdog_s = ACCEPTED, min(command[20] / 1000.0, 0.5)
        print("executed", self.name, self.sequence, code, flush=True)
        if code == ENABLE:
            self.state, self.result = STANDSTILL if self.state == DISABLED else self.state, DONE
        elif code == DISABLE:
            self.stop(DISABLED)
        elif code == RESET:
            self.fault, self.result = 0, DONE
            self.state = DISABLED if self.state == ERROR_STOP else self.state
        elif code == HALT:
            self.stop(self.then if self.state == STOPPING else self.state if self.state in (DISABLED, ERROR_STOP) else STANDSTILL)
        elif code == HOME:
            self.state, self.home_at, self.result = HOMING, now + 0.2, RUNNING
        elif code == MOVE:
            for index in self.masked():
                self.axes[index].target, self.axes[index].speed = targets[index], speeds[index]
            self.state, self.result = DISCRETE, RUNNING

    def masked(self):
        return [index for index in range(4) if self.mask >> index & 1]

    def why_not(self, command, code, targets, speeds):
        if command[21] != 0 and command[21] != crc16([0] + command[1:21]):
            return REFUSED_CRC
        if code in (HALT, DISABLE):
            return 0
        if code in (ENABLE, RESET):
            return REFUSED_STATE if code == ENABLE and (self.fault or self.state == STOPPING) else 0
        if code not in (HOME, MOVE):
            return REFUSED_CODE
        if self.fault or self.state not in (STANDSTILL, DISCRETE) or not command[3] & 1 or not self.masked():
            return REFUSED_STATE
        for index in self.masked() if code == MOVE else []:
            axis = self.axes[index]
            if not axis.homed:
                return REFUSED_STATE
            if not axis.lower <= targets[index] <= axis.upper:
                return REFUSED_LIMIT
            if not 0.0 <= speeds[index] <= axis.top_speed:
                return REFUSED_SPEED
        return 0

    async def show(self, now):
        status = [0] * 64
        flags = 0
        for index, axis in enumerate(self.axes):
            flags |= axis.homed << index | axis.rests() << 4 + index
            status[11 + index] = self.state if self.state != DISCRETE or not axis.rests() else STANDSTILL
        fault = self.fault or self.refusal
        head = [0x4D01, int(now * 50) & 0xFFFF, self.echo, 2, 0b1111, self.state, self.sequence, self.result]
        status[0:11] = head + [fault >> 16, fault & 0xFFFF, flags]
        numbers = [[axis.position for axis in self.axes]] * 2
        numbers += [[getattr(axis, name) for axis in self.axes] for name in ("lower", "upper", "top_speed")]
        packed = b"".join(struct.pack(">4f", *values) for values in numbers)
        status[16:56] = struct.unpack(f">{len(packed) // 2}H", packed)
        uptime = int(now * 1000) & 0xFFFFFFFF
        status[56:58] = [uptime >> 16, uptime & 0xFFFF]
        registers[self.base + 62] = self.cycles & 0xFFFF
        if self.cycles % 100 == 99:
            await asyncio.sleep(0.002)
        registers[self.base : self.base + 62] = status[:62]
        registers[self.base + 63] = self.cycles & 0xFFFF


async def access(_function, start, address, count, current, values):
    """Transfers registers between the server and the PLC. Status blocks cannot be written."""
    if values is None:
        current[address - start : address - start + count] = registers[address : address + count]
    else:
        if any((address + index) % STEP < COMMAND for index in range(len(values))):
            from pymodbus.constants import ExcCodes

            return ExcCodes.ILLEGAL_ADDRESS
        registers[address : address + len(values)] = values
    return None


async def main():
    devices = [Device("m1", 0, MANIPULATOR), Device("m2", STEP, MANIPULATOR), Device("stage", 2 * STEP, RAIL)]
    memory = SimData(0, values=0, count=len(registers), datatype=DataType.REGISTERS)
    began = last = time.monotonic()
    for device in devices:
        await device.show(0.0)
    server = ModbusTcpServer(SimDevice(0, simdata=[memory], action=access), address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    print("READY", server.transport.sockets[0].getsockname()[1], flush=True)
    while True:
        await asyncio.sleep(CYCLE_S)
        now = time.monotonic()
        for device in devices:
            device.cycle(now - began, now - last)
            await device.show(now - began)
        last = now


if __name__ == "__main__":
    try:
        asyncio.run(main())
    except KeyboardInterrupt:
        sys.exit(0)
