"""MPEG transport streams, as the standard says."""

from collections import defaultdict

from hypothesis import given
from hypothesis import strategies as st
from robotether_server.relay.channels.video.mpeg_ts import DELIMITER, PAT, PMT, TransportStream

PACKET_BYTES = 188
VIDEO_PID = 0x100


class Demuxer:
    """Reads a stream by the letter of the standard."""

    def __init__(self, stream):
        assert len(stream) % PACKET_BYTES == 0
        self.payloads = defaultdict(list)
        self.clocks = []
        self._counters = {}
        for begin in range(0, len(stream), PACKET_BYTES):
            self._read(stream[begin : begin + PACKET_BYTES])

    def _read(self, packet):
        pid, counter = int.from_bytes(packet[1:3], "big"), packet[3] & 0x0F
        starts, pid = bool(pid & 0x4000), pid & 0x1FFF
        assert packet[0] == 0x47
        assert counter == self._counters.get(pid, counter)
        self._counters[pid] = (counter + 1) % 16
        begin = 4
        if packet[3] & 0x20:
            begin += 1 + packet[4]
            assert begin <= PACKET_BYTES
            if packet[4] and packet[5] & 0x10:
                self.clocks.append(int.from_bytes(packet[6:12], "big") >> 15)
        if starts:
            self.payloads[pid].append(b"")
        self.payloads[pid][-1] += packet[begin:]

    def frames(self):
        return [(self._timestamp(pes), pes[14:]) for pes in self.payloads[VIDEO_PID]]

    @staticmethod
    def _timestamp(pes):
        assert pes[:4] == b"\0\0\1\xe0"
        length = int.from_bytes(pes[4:6], "big")
        assert length == (len(pes) - 6 if len(pes) < 2**16 + 6 else 0)
        bits = f"{int.from_bytes(pes[9:14], 'big'):040b}"
        assert (bits[:4], bits[7], bits[23], bits[39]) == ("0010", "1", "1", "1")
        return int(bits[4:7] + bits[8:23] + bits[24:39], 2)


FRAMES = st.lists(
    st.tuples(st.one_of(st.integers(1, 800), st.integers(65_400, 66_000)), st.booleans()),
    min_size=1,
    max_size=5,
)


@given(FRAMES, st.floats(-1e9, 1e9), st.lists(st.floats(-1, 3600), min_size=5, max_size=5))
def test_each_frame_comes_out_as_it_went_in(frames, begin_s, steps_s):
    """Whole packets, counters without a gap, and timestamps that only grow and are ahead of the clock."""
    stream, timestamp_s, written, expected = TransportStream(), begin_s, b"", []
    for (size, is_key), step_s in zip(frames, steps_s, strict=False):
        frame = (bytes(range(251)) * 264)[:size]
        written += stream.write(memoryview(frame), timestamp_s, is_key=is_key)
        expected.append(DELIMITER + frame)
        timestamp_s += step_s
    demuxer = Demuxer(written)
    assert [frame for _, frame in demuxer.frames()] == expected
    timestamps = [timestamp for timestamp, _ in demuxer.frames()]
    assert timestamps == sorted(set(timestamps))
    behind = zip(timestamps, demuxer.clocks, strict=True)
    assert {timestamp - clock for timestamp, clock in behind} == {9000}
    assert demuxer.payloads[0][0].startswith(b"\0" + PAT)
    assert demuxer.payloads[0x1000][0].startswith(b"\0" + PMT)


def test_timestamps_have_33_bits():
    """A stream of days begins them anew, and a player counts on."""
    stream = TransportStream()
    first = stream.write(b"x", 0.0, is_key=True)
    later = stream.write(b"x", 2**33 / 90_000, is_key=True)
    assert [timestamp for timestamp, _ in Demuxer(first + later).frames()] == [90_000] * 2
