-- What a backup that is put back leaves in the audit log (docs/adr/0061-a-restore-is-a-line.md), and what the page Health shows
-- of each cell. As in 0001, every statement may run twice.

-- lost_since: position of the line records_restored; what the robot signed is of a line that was there before, and is not any
-- more. NULL: the line is in the log.
ALTER TABLE audit_heads
  ADD COLUMN IF NOT EXISTS lost_since BIGINT UNSIGNED NULL,
  DROP INDEX IF EXISTS audit_heads_position,
  ADD UNIQUE INDEX IF NOT EXISTS audit_heads_line (chain, signer, position, hash);

-- Adds what a robot signed, if that line is in the log, or was lost by a restore since the robot last signed a line that is.
-- Answers one row, is_kept. Relays check the signature before.
CREATE OR REPLACE PROCEDURE add_robots_head(IN chain_ VARCHAR(63), IN position_ BIGINT UNSIGNED, IN hash_ BINARY(32),
  IN public_key_ VARCHAR(2048), IN previous_ BINARY(32), IN signature_ VARCHAR(2048))
BEGIN
  DECLARE since BIGINT UNSIGNED DEFAULT NULL;
  DECLARE is_there BOOLEAN DEFAULT
    EXISTS (SELECT 1 FROM audit_events WHERE robot = chain_ AND position = position_ AND hash = hash_)
    OR EXISTS (SELECT 1 FROM audit_heads
      WHERE chain = chain_ AND signer = 'server' AND position = position_ AND hash = hash_);
  IF NOT is_there THEN
    SET since = (SELECT MIN(position) FROM audit_events
      WHERE robot = chain_ AND kind = 'records_restored' AND position <= position_ AND position > IFNULL(
        (SELECT MAX(position) FROM audit_heads WHERE chain = chain_ AND signer = 'robot' AND lost_since IS NULL), 0));
  END IF;
  IF is_there OR since IS NOT NULL THEN
    INSERT IGNORE INTO audit_heads (chain, position, hash, signer, public_key, previous, signature, lost_since)
      VALUES (chain_, position_, hash_, 'robot', public_key_, previous_, signature_, since);
  END IF;
  SELECT is_there OR since IS NOT NULL AS is_kept;
END;
GRANT EXECUTE ON PROCEDURE add_robots_head TO 'relay'@'%';

-- Adds a line to each chain; tools/restore calls it, before anything else writes. records_of: when the backup was made, as its
-- relays wrote last.
CREATE OR REPLACE PROCEDURE record_restore()
BEGIN
  DECLARE chain_ VARCHAR(63);
  DECLARE is_done BOOLEAN DEFAULT FALSE;
  DECLARE records_of TIMESTAMP(6)
    DEFAULT COALESCE((SELECT MAX(heartbeat_at) FROM cells), (SELECT MAX(at) FROM audit_events), '1970-01-02');
  -- The trigger must not write a table that the same statement reads.
  DECLARE chains CURSOR FOR SELECT chain FROM audit_chains ORDER BY chain;
  DECLARE CONTINUE HANDLER FOR NOT FOUND SET is_done = TRUE;
  OPEN chains;
  FETCH chains INTO chain_;
  WHILE NOT is_done DO
    INSERT INTO audit_events (actor, kind, robot, details) VALUES ('restore', 'records_restored', NULLIF(chain_, ''),
      JSON_OBJECT('records_of', DATE_FORMAT(CONVERT_TZ(records_of, @@time_zone, '+00:00'), '%Y-%m-%dT%H:%i:%s.%f+00:00')));
    FETCH chains INTO chain_;
  END WHILE;
  CLOSE chains;
END;

-- As in 0028, but what is lost since a line that is deleted goes with it.
CREATE OR REPLACE PROCEDURE prune_audit_chains(IN oldest TIMESTAMP(6))
BEGIN
  DECLARE chain_ VARCHAR(63);
  DECLARE first_, last_, anchor BIGINT UNSIGNED;
  DECLARE room INT DEFAULT 50000;
  DECLARE is_done BOOLEAN DEFAULT FALSE;
  DECLARE chains CURSOR FOR
    SELECT chain, MAX(position) FROM audit_heads WHERE signer = 'server' AND signed_at < oldest GROUP BY chain;
  DECLARE CONTINUE HANDLER FOR NOT FOUND SET is_done = TRUE;
  OPEN chains;
  FETCH chains INTO chain_, last_;
  WHILE NOT is_done AND room > 0 DO
    SET first_ = (SELECT MIN(position) FROM audit_events WHERE robot <=> NULLIF(chain_, ''));
    IF first_ <= last_ THEN
      SET anchor = IFNULL(
        (SELECT MAX(position) FROM audit_heads
          WHERE chain = chain_ AND signer = 'server' AND position BETWEEN first_ AND LEAST(last_, first_ + room - 1)),
        (SELECT MIN(position) FROM audit_heads WHERE chain = chain_ AND signer = 'server' AND position >= first_));
      DELETE FROM audit_events WHERE robot <=> NULLIF(chain_, '') AND position <= anchor;
      SET room = room - ROW_COUNT();
      DELETE FROM audit_heads WHERE chain = chain_ AND (position < anchor OR lost_since <= anchor);
    END IF;
    FETCH chains INTO chain_, last_;
  END WHILE;
  CLOSE chains;
END;

-- What a cell's relay writes with each heartbeat. disk_free: part of its disk that is free, from 0 to 1; recorders: number of
-- recorders that are connected to it. NULL: unknown, or its relay is older.
ALTER TABLE cells
  ADD COLUMN IF NOT EXISTS disk_free DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS recorders INT UNSIGNED NULL;
GRANT INSERT (disk_free, recorders), UPDATE (disk_free, recorders) ON cells TO 'relay'@'%';
