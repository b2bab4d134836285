-- What the page Health shows of each cell is no older than it says, and what the audit log gets from web and recorder is as of
-- now. As in 0001, every statement may run twice.

-- counted_at: when the cell's relay wrote disk_free and recorders. An older relay writes the row and leaves them, and counted_at,
-- as they were: then it differs from heartbeat_at. A column that is added later needs a time of its own.
-- recordings_free: part of the disk with the recordings that is free, from 0 to 1, as the cell's recorder wrote at
-- recordings_counted_at; NULL: unknown.
ALTER TABLE cells
  ADD COLUMN IF NOT EXISTS counted_at TIMESTAMP(6) NULL DEFAULT NULL,
  ADD COLUMN IF NOT EXISTS recordings_free DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS recordings_counted_at TIMESTAMP(6) NULL DEFAULT NULL;
GRANT INSERT (counted_at), UPDATE (counted_at) ON cells TO 'relay'@'%';
GRANT SELECT (name), UPDATE (recordings_free, recordings_counted_at) ON cells TO 'recorder'@'%';

-- Whoever took over web or recorder can add lines, but none of an earlier time, and none that lists show before others. Relays
-- write some lines late, with their time.
GRANT INSERT ON audit_events TO 'web'@'%';
REVOKE INSERT ON audit_events FROM 'web'@'%';
GRANT INSERT (actor, kind, robot, address, details) ON audit_events TO 'web'@'%';
GRANT INSERT ON audit_events TO 'recorder'@'%';
REVOKE INSERT ON audit_events FROM 'recorder'@'%';
GRANT INSERT (actor, kind, robot, address, details) ON audit_events TO 'recorder'@'%';
