-- What a drive was like for its driver. Written by the relay alone; NULL in rows from before these columns.

-- latency_*: round trip from the driver to the robot, by the relay's pings of both. bytes: rosbridge's messages, both
-- ways. pictures, picture_bytes: video that the driver got; viewed_s: for so long the driver had a video open.
ALTER TABLE drives
  ADD COLUMN IF NOT EXISTS latency_p50_ms DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS latency_p95_ms DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS bytes BIGINT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS pictures BIGINT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS picture_bytes BIGINT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS viewed_s DOUBLE NULL;
