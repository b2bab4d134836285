-- Regions: where a cell is, as its relay writes it with each heartbeat, and where the robots that a join token admits are;
-- NULL: not said. A robot's own stands in its settings (docs/adr/0036-cells-and-one-host-key.md).
ALTER TABLE cells ADD COLUMN IF NOT EXISTS region VARCHAR(63) NULL;
ALTER TABLE join_tokens ADD COLUMN IF NOT EXISTS region VARCHAR(63) NULL;

GRANT INSERT (region), UPDATE (region) ON cells TO 'relay'@'%';
