-- The audit log as chains: each line has the hash of the line before it, one chain a robot, and one of the lines without a
-- robot (docs/reference/audit-log.md, docs/adr/0054-audit-chains-in-the-database.md). As in 0001, every statement may run twice.

-- position: from 1 in its chain; hash: of this line and all before it. NULL: outside the chains, as lines from before this
-- migration, and those of refused keys, which count further refusals and so change.
ALTER TABLE audit_events
  ADD COLUMN IF NOT EXISTS position BIGINT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS hash BINARY(32) NULL,
  ADD INDEX IF NOT EXISTS audit_events_chain (robot, position);

-- The newest line of each chain, whose lock makes its writers take turns. chain: the robot's name; '': lines without one.
CREATE TABLE IF NOT EXISTS audit_chains (
  chain VARCHAR(63) NOT NULL PRIMARY KEY,
  position BIGINT UNSIGNED NOT NULL,
  hash BINARY(32) NOT NULL
);

-- Signed heads: lines up to which a chain is signed, by the server's relays and by the robot itself. public_key is as OpenSSH
-- writes it. previous: the SHA-256 of what the robot signed before, NULL: nothing, or the server's.
CREATE TABLE IF NOT EXISTS audit_heads (
  id BIGINT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  chain VARCHAR(63) NOT NULL,
  position BIGINT UNSIGNED NOT NULL,
  hash BINARY(32) NOT NULL,
  signer ENUM('server', 'robot') NOT NULL,
  public_key VARCHAR(2048) NOT NULL,
  previous BINARY(32) NULL,
  signature VARCHAR(2048) NOT NULL,
  signed_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  UNIQUE KEY audit_heads_position (chain, signer, position),
  KEY audit_heads_signed_at (signer, signed_at)
);

-- Every writer's lines pass here, in the transaction of the line, with no right of the writer on chains. What is hashed is in
-- docs/reference/audit-log.md, and again in server/robotether_server/audit_chain.py.
CREATE OR REPLACE TRIGGER audit_events_before_insert BEFORE INSERT ON audit_events FOR EACH ROW
BEGIN
  DECLARE position_ BIGINT UNSIGNED DEFAULT NULL;
  DECLARE before_ BINARY(32);
  IF NEW.kind <> 'key_refused' THEN
    SELECT position + 1, hash INTO position_, before_ FROM audit_chains WHERE chain = IFNULL(NEW.robot, '') FOR UPDATE;
    IF position_ IS NULL THEN
      -- Of two writers who begin a chain, the second waits here.
      INSERT INTO audit_chains (chain, position, hash)
        VALUES (IFNULL(NEW.robot, ''), 0, UNHEX(SHA2(CONCAT('robotether audit chain 1:', IFNULL(NEW.robot, '')), 256)))
        ON DUPLICATE KEY UPDATE position = audit_chains.position;
      SELECT position + 1, hash INTO position_, before_ FROM audit_chains WHERE chain = IFNULL(NEW.robot, '') FOR UPDATE;
    END IF;
    SET NEW.hash = UNHEX(SHA2(CONCAT(before_, UNHEX(SHA2(CONCAT(
      OCTET_LENGTH(position_), ':', position_,
      OCTET_LENGTH(UNIX_TIMESTAMP(NEW.at)), ':', UNIX_TIMESTAMP(NEW.at),
      OCTET_LENGTH(NEW.actor), ':', NEW.actor,
      OCTET_LENGTH(NEW.kind), ':', NEW.kind,
      IFNULL(CONCAT(OCTET_LENGTH(NEW.robot), ':', NEW.robot), '-'),
      IFNULL(CONCAT(OCTET_LENGTH(NEW.address), ':', NEW.address), '-'),
      OCTET_LENGTH(NEW.details), ':', NEW.details), 256))), 256));
    UPDATE audit_chains SET position = position_, hash = NEW.hash WHERE chain = IFNULL(NEW.robot, '');
  ELSE
    SET NEW.hash = NULL;
  END IF;
  SET NEW.position = position_;
END;

-- The first line of each chain that there is a robot for says that older lines are in none.
INSERT INTO audit_events (actor, kind, robot)
  SELECT 'migrate', 'chain_started', r.name FROM (SELECT name FROM robots UNION ALL SELECT NULL) r
  WHERE NOT EXISTS (SELECT 1 FROM audit_events e WHERE e.robot <=> r.name AND e.position IS NOT NULL);

-- Deletes the lines that are older, up to a head that the server signed before that time: it stays, and has the number of
-- lines that were deleted and their hash. Some 50000 lines at most, so that no transaction gets long.
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
      DELETE FROM audit_heads WHERE chain = chain_ AND position < anchor;
    END IF;
    FETCH chains INTO chain_, last_;
  END WHILE;
  CLOSE chains;
END;

-- As in 0025, but lines in chains.
CREATE OR REPLACE PROCEDURE prune_history()
BEGIN
  DECLARE days_ INT DEFAULT (SELECT IF(days > 0, days, NULL) FROM retention);
  DECLARE oldest TIMESTAMP(6) DEFAULT CURRENT_TIMESTAMP(6) - INTERVAL days_ DAY;
  DELETE FROM audit_events WHERE at < oldest AND position IS NULL ORDER BY at LIMIT 50000;
  DELETE FROM audit_events WHERE kind = 'key_refused' AND at < CURRENT_TIMESTAMP(6) - INTERVAL 30 DAY ORDER BY at LIMIT 50000;
  CALL prune_audit_chains(oldest);
  DELETE FROM drives WHERE ended_at < oldest ORDER BY id LIMIT 50000;
  DELETE FROM help_requests WHERE closed_at < oldest ORDER BY closed_at LIMIT 50000;
  DELETE FROM robot_sessions WHERE ended_at < oldest
    AND id NOT IN (SELECT id FROM (SELECT MAX(id) AS id FROM robot_sessions GROUP BY robot_id) AS newest)
    ORDER BY ended_at LIMIT 50000;
END;

-- What a record of a drive says of its vehicle: the key and versions it had, and its position in metres, by the pose topic of
-- its geofence. NULL: unknown, or from before these columns.
ALTER TABLE drives
  ADD COLUMN IF NOT EXISTS robot_key VARCHAR(64) NULL,
  ADD COLUMN IF NOT EXISTS agent_version VARCHAR(32) NULL,
  ADD COLUMN IF NOT EXISTS server_version VARCHAR(32) NULL,
  ADD COLUMN IF NOT EXISTS start_x_m DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS start_y_m DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS end_x_m DOUBLE NULL,
  ADD COLUMN IF NOT EXISTS end_y_m DOUBLE NULL;

-- As in 0015; the audit log gets the end of drives, and until when they lasted at least.
CREATE OR REPLACE PROCEDURE remove_cell(IN cell_name VARCHAR(63)) SQL SECURITY DEFINER
BEGIN
  DECLARE last_alive TIMESTAMP(6) DEFAULT (SELECT heartbeat_at FROM cells WHERE name = cell_name);
  INSERT INTO audit_events (actor, kind, robot, details)
    SELECT l.user_name, 'drive_ended', r.name, JSON_OBJECT('end_code', 'cell_removed', 'fence', l.fence,
      'at_least_until', DATE_FORMAT(COALESCE(d.ended_at, d.updated_at, l.since), '%Y-%m-%dT%H:%i:%s.%f+00:00'))
    FROM control_leases l JOIN robots r ON r.id = l.robot_id
    LEFT JOIN drives d ON d.robot_id = l.robot_id AND d.fence = l.fence
    WHERE l.ended_at IS NULL AND l.cell = cell_name ORDER BY r.name;
  UPDATE robot_sessions SET ended_at = last_alive, end_code = 'cell_removed' WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE drives SET ended_at = updated_at, end_code = 'cell_removed' WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE control_leases SET ended_at = last_alive WHERE cell = cell_name AND ended_at IS NULL;
  DELETE FROM cells WHERE name = cell_name;
END;

GRANT SELECT ON audit_chains TO 'web'@'%';
GRANT SELECT ON audit_heads TO 'web'@'%';
GRANT SELECT ON audit_chains TO 'relay'@'%';
GRANT SELECT, INSERT (chain, position, hash, signer, public_key, previous, signature) ON audit_heads TO 'relay'@'%';
