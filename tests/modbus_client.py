"""An independent client of `coaxis simulate plc --modbus`: pymodbus by docs/modbus.md alone. The exit code is 0 if all agrees.

    python tests/modbus_client.py PORT
"""

import struct
import sys
import time

from pymodbus.client import ModbusTcpClient


def crc16(words):
    crc = 0xFFFF
    for byte in struct.pack(f">{len(words)}H", *words):
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def words_of(values):
    return list(struct.unpack(f">{2 * len(values)}H", struct.pack(f">{len(values)}f", *values)))


def values_of(words):
    return list(struct.unpack(f">{len(words) // 2}f", struct.pack(f">{len(words)}H", *words)))


class Device:
    def __init__(self, client, base, unit):
        self.client, self.base, self.unit, self.heartbeat = client, base, unit, 0

    def status(self):
        answer = self.client.read_input_registers(self.base, count=64, device_id=self.unit)
        assert not answer.isError(), answer
        words = answer.registers
        assert words[0] == 0x4D01 and words[62] == words[63], words
        return words

    def command(self, sequence, code, mask=0b1111, targets=(0, 0, 0, 0), speeds=(0, 0, 0, 0), damage=0):
        body = [code, mask, 1] + words_of(targets) + words_of(speeds) + [400]
        words = [self.heartbeat] + body + [crc16([0] + body) ^ damage, 0, sequence]
        return self.client.write_registers(self.base + 128, words, device_id=self.unit)

    def beat(self):
        self.heartbeat = (self.heartbeat + 1) & 0xFFFF
        answer = self.client.write_register(self.base + 128, self.heartbeat, device_id=self.unit)
        assert not answer.isError(), answer

    def until_over(self, sequence):
        for _ in range(500):
            self.beat()
            words = self.status()
            if words[6] == sequence and words[7] not in (1, 2):
                return words
            time.sleep(0.01)
        raise AssertionError(f"command {sequence} does not end: {words[:11]}")


def main(port):
    client = ModbusTcpClient("127.0.0.1", port=port)
    assert client.connect()
    m1, m2, stage = Device(client, 0, 1), Device(client, 0, 2), Device(client, 512, 1)
    for device in (m1, m2, stage):
        words = device.status()
        assert words[5] == 1 and words[6] == 0, "disabled, and no command yet"
        lower, upper = values_of(words[32:40]), values_of(words[40:48])
        assert all(low < high for low, high in zip(lower, upper)), (lower, upper)
    assert abs(values_of(m1.status()[46:48])[0] - 12.0) < 1e-5, "the limit of c is in degrees"

    assert not m1.command(7, 1).isError()
    assert m1.until_over(7)[7] == 3, "enabled"
    assert not m1.command(8, 5, 0b1001, (1.5, 0, 0, -2.25), (10, 0, 0, 6)).isError()
    words = m1.until_over(8)
    actual = values_of(words[16:24])
    assert words[7] == 3 and words[5] == 2, words[:11]
    assert abs(actual[0] - 1.5) < 1e-4 and abs(actual[3] + 2.25) < 1e-4 and actual[1] == actual[2] == 0, actual
    assert words[2] == m1.heartbeat, "the heartbeat of the client comes back"

    m1.command(8, 5, 0b0001, (5, 0, 0, 0), (10, 0, 0, 0))
    m1.command(7, 5, 0b0001, (5, 0, 0, 0), (10, 0, 0, 0))
    time.sleep(0.1)
    assert abs(values_of(m1.status()[16:18])[0] - 1.5) < 1e-4, "numbers that are not newer move nothing"
    m1.command(9, 5, 0b0001, (50.5, 0, 0, 0), (10, 0, 0, 0))
    assert m1.until_over(9)[7] == 4, "a target beyond the limit is rejected"
    assert m1.command(10, 5, 0b0001, (5, 0, 0, 0), (10, 0, 0, 0), damage=1).exception_code == 3, "the CRC is checked"
    assert m1.status()[6] == 9

    assert not m1.command(11, 5, 0b0001, (40, 0, 0, 0), (10, 0, 0, 0)).isError()
    time.sleep(1.0)
    words = m1.status()
    assert words[5] == 3 and words[7] == 5, f"the watchdog of 400 ms has stopped it: {words[:11]}"
    assert values_of(words[16:18])[0] < 1.5 + 10 * 0.4 + 2.0

    assert m2.status()[6] == 0 and stage.status()[6] == 0, "the others got no command"
    illegal_address = client.read_input_registers(100, count=64, device_id=1)
    assert illegal_address.isError() and illegal_address.exception_code == 2
    assert client.write_registers(0, [1], device_id=1).exception_code == 2, "the status cannot be written"
    assert client.read_coils(0, count=1, device_id=1).exception_code == 1, "no other functions"
    client.close()
    print("as documented")


if __name__ == "__main__":
    main(int(sys.argv[1]))
