-- How old was what the driver saw, by the robot's clock, when the commands reached the robot that moved it. seen_*_ms: of
-- those commands whose frames the robot knew; seen_unknown: number of the others, of a driver whose page names frames. The
-- robot's guard measures it. NULL: it reported nothing.
ALTER TABLE drives
  ADD COLUMN IF NOT EXISTS seen_p50_ms DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS seen_p95_ms DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS seen_p99_ms DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS seen_max_ms DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS seen_unknown BIGINT UNSIGNED NULL;
