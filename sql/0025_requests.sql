-- Requests for help, the operators who answer them, and the row whose lock makes all changes of them take turns
-- (docs/adr/0049-planning-in-the-operators-polls.md). As in 0001, every statement may run twice.

-- offered_to and accepted_by are set in the states of that name; accepted_by stays when the request is closed. A user who
-- is removed leaves NULL, and the request waits again. open_source: one open request a robot and source.
CREATE TABLE IF NOT EXISTS help_requests (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  robot_id INT UNSIGNED NOT NULL,
  reason VARCHAR(200) NOT NULL,
  source VARCHAR(16) NOT NULL,
  priority TINYINT UNSIGNED NOT NULL,
  pool VARCHAR(63) NOT NULL DEFAULT '',
  asked_by VARCHAR(63) NOT NULL,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  state ENUM('waiting', 'offered', 'accepted', 'closed', 'cancelled') NOT NULL DEFAULT 'waiting',
  offered_to INT UNSIGNED NULL,
  offer_until TIMESTAMP(6) NULL DEFAULT NULL,
  accepted_by INT UNSIGNED NULL,
  accepted_at TIMESTAMP(6) NULL DEFAULT NULL,
  closed_at TIMESTAMP(6) NULL DEFAULT NULL,
  note VARCHAR(500) NULL,
  open_source VARCHAR(16) AS (IF(state IN ('closed', 'cancelled'), NULL, source)) STORED,
  UNIQUE KEY help_requests_open (robot_id, open_source),
  KEY help_requests_state (state, priority, created_at),
  KEY help_requests_accepted_at (accepted_at),
  KEY help_requests_closed_at (closed_at),
  CONSTRAINT help_requests_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE CASCADE,
  CONSTRAINT help_requests_offered_to FOREIGN KEY (offered_to) REFERENCES users (id) ON DELETE SET NULL,
  CONSTRAINT help_requests_accepted_by FOREIGN KEY (accepted_by) REFERENCES users (id) ON DELETE SET NULL,
  CONSTRAINT help_requests_priority CHECK (priority BETWEEN 1 AND 3),
  CONSTRAINT help_requests_source CHECK (
    source IN ('api', 'page', 'robot', 'stop', 'battery', 'diagnostics', 'geofence', 'navigation'))
);

-- When each user last declined a request, or let its offer end.
CREATE TABLE IF NOT EXISTS help_request_passes (
  request_id INT UNSIGNED NOT NULL,
  user_id INT UNSIGNED NOT NULL,
  passed_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  PRIMARY KEY (request_id, user_id),
  CONSTRAINT help_request_passes_request FOREIGN KEY (request_id) REFERENCES help_requests (id) ON DELETE CASCADE,
  CONSTRAINT help_request_passes_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE
);

-- Users who have opened the queue. available: what the user chose last; idle_since: until when the user last was anything
-- else than idle.
CREATE TABLE IF NOT EXISTS operators (
  user_id INT UNSIGNED NOT NULL PRIMARY KEY,
  available BOOLEAN NOT NULL,
  last_seen_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  idle_since TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  wrap_up_until TIMESTAMP(6) NULL DEFAULT NULL,
  CONSTRAINT operators_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE
);

CREATE TABLE IF NOT EXISTS pool_members (
  pool VARCHAR(63) NOT NULL,
  user_id INT UNSIGNED NOT NULL,
  PRIMARY KEY (user_id, pool),
  CONSTRAINT pool_members_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE,
  CONSTRAINT pool_members_pool CHECK (pool REGEXP '^[a-z0-9][a-z0-9._-]*\\z')
);

-- One row. Whoever plans, accepts, declines, assigns, closes or adds a request locks it first.
CREATE TABLE IF NOT EXISTS planner (
  id TINYINT UNSIGNED NOT NULL DEFAULT 1 PRIMARY KEY,
  planned_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  CONSTRAINT planner_one CHECK (id = 1)
);
INSERT IGNORE INTO planner (id) VALUES (1);

-- Adds a request to those of its robot, and answers its id and whether it is new. The open one of the same source stays,
-- and gets the more urgent priority of the two. The id is NULL: the robot has 4 open requests, or is not active. A robot
-- that repeats itself waits for no lock.
CREATE OR REPLACE PROCEDURE add_help_request(
  IN robot_id_ INT UNSIGNED, IN source_ VARCHAR(16), IN reason_ VARCHAR(200), IN priority_ TINYINT UNSIGNED,
  IN pool_ VARCHAR(63), IN asker VARCHAR(63), IN address_ VARCHAR(45))
SQL SECURITY DEFINER
BEGIN
  DECLARE is_new BOOLEAN DEFAULT FALSE;
  DECLARE locked TINYINT UNSIGNED;
  DECLARE request_id_ INT UNSIGNED DEFAULT (
    SELECT id FROM help_requests WHERE robot_id = robot_id_ AND open_source = source_ AND priority <= priority_);
  IF request_id_ IS NULL THEN
    SELECT id INTO locked FROM planner WHERE id = 1 FOR UPDATE;
    SET request_id_ = (SELECT id FROM help_requests WHERE robot_id = robot_id_ AND open_source = source_);
    IF request_id_ IS NOT NULL THEN
      UPDATE help_requests SET priority = LEAST(priority, priority_) WHERE id = request_id_;
    ELSEIF (SELECT COUNT(*) FROM help_requests WHERE robot_id = robot_id_ AND open_source IS NOT NULL) < 4
      AND EXISTS (SELECT 1 FROM robots WHERE id = robot_id_ AND state = 'active') THEN
      INSERT INTO help_requests (robot_id, reason, source, priority, pool, asked_by)
        VALUES (robot_id_, reason_, source_, priority_, pool_, asker);
      SET request_id_ = LAST_INSERT_ID(), is_new = TRUE;
      INSERT INTO audit_events (actor, kind, robot, address, details)
        SELECT asker, 'request_made', name, address_, JSON_OBJECT(
            'request', request_id_, 'source', source_, 'reason', reason_, 'priority', priority_, 'pool', pool_)
        FROM robots WHERE id = robot_id_;
    END IF;
  END IF;
  SELECT request_id_ AS id, is_new;
END;

-- For the relay: a robot asks. Nothing of what it says makes the call fail: a text that is too long is cut, a pool that
-- nobody can have is any, a source that it may not name is `robot`.
CREATE OR REPLACE PROCEDURE ask_for_help(
  IN robot_id_ INT UNSIGNED, IN source_ TEXT, IN reason_ TEXT, IN priority_ INT, IN pool_ TEXT)
SQL SECURITY DEFINER
BEGIN
  CALL add_help_request(
    robot_id_,
    IF(source_ IN ('stop', 'battery', 'diagnostics', 'geofence', 'navigation'), source_, 'robot'),
    LEFT(REGEXP_REPLACE(IFNULL(reason_, ''), '[[:cntrl:]]', ' '), 200),
    LEAST(GREATEST(IFNULL(priority_, 2), 1), 3),
    IF(CHAR_LENGTH(pool_) <= 63 AND pool_ REGEXP '^[a-z0-9][a-z0-9._-]*\\z', pool_, ''),
    (SELECT name FROM robots WHERE id = robot_id_),
    NULL);
END;

-- For the relay: the open requests, and for whom each reserves its robot for how long; NULL: for nobody.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_requests AS
  SELECT h.robot_id, h.state, TIMESTAMPDIFF(MICROSECOND, h.created_at, CURRENT_TIMESTAMP(6)) / 1e6 AS age_s,
    u.id AS user_id, u.name AS user_name,
    TIMESTAMPDIFF(MICROSECOND, CURRENT_TIMESTAMP(6),
      IF(h.state = 'offered', h.offer_until, h.accepted_at + INTERVAL 30 SECOND)) / 1e6 AS left_s
  FROM help_requests h
  LEFT JOIN users u ON u.id = IF(h.state = 'offered', h.offered_to, h.accepted_by) AND NOT u.disabled
  WHERE h.state IN ('waiting', 'offered', 'accepted');

-- As in 0018, and closed requests.
CREATE OR REPLACE PROCEDURE prune_history()
BEGIN
  DECLARE days_ INT DEFAULT (SELECT IF(days > 0, days, NULL) FROM retention);
  DECLARE oldest TIMESTAMP(6) DEFAULT CURRENT_TIMESTAMP(6) - INTERVAL days_ DAY;
  DELETE FROM audit_events WHERE at < oldest ORDER BY at LIMIT 50000;
  DELETE FROM audit_events WHERE kind = 'key_refused' AND at < CURRENT_TIMESTAMP(6) - INTERVAL 30 DAY ORDER BY at LIMIT 50000;
  DELETE FROM drives WHERE ended_at < oldest ORDER BY id LIMIT 50000;
  DELETE FROM help_requests WHERE closed_at < oldest ORDER BY closed_at LIMIT 50000;
  DELETE FROM robot_sessions WHERE ended_at < oldest
    AND id NOT IN (SELECT id FROM (SELECT MAX(id) AS id FROM robot_sessions GROUP BY robot_id) AS newest)
    ORDER BY ended_at LIMIT 50000;
END;

GRANT SELECT, UPDATE ON help_requests TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON help_request_passes TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE ON operators TO 'web'@'%';
GRANT SELECT, INSERT, DELETE ON pool_members TO 'web'@'%';
GRANT SELECT, UPDATE ON planner TO 'web'@'%';
GRANT EXECUTE ON PROCEDURE add_help_request TO 'web'@'%';
GRANT SELECT ON relay_requests TO 'relay'@'%';
GRANT EXECUTE ON PROCEDURE ask_for_help TO 'relay'@'%';
