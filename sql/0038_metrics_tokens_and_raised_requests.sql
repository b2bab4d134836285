-- API tokens that read the metrics and do nothing else: Prometheus keeps one on its disk.

-- NULL: it may do what its user may do. The hash of any other token is not that of its text (db/credentials.py), so that
-- whoever looks for a token of all rights, a version before this one too, never finds it.
ALTER TABLE api_tokens ADD COLUMN IF NOT EXISTS only_for ENUM('metrics') NULL DEFAULT NULL;

-- As in 0025, and a line in the audit log when a request becomes more urgent, with the reason, which the request does not
-- take over.
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
      UPDATE help_requests SET priority = priority_ WHERE id = request_id_ AND priority > priority_;
      IF ROW_COUNT() > 0 THEN
        INSERT INTO audit_events (actor, kind, robot, address, details)
          SELECT asker, 'request_raised', name, address_, JSON_OBJECT(
              'request', request_id_, 'source', source_, 'reason', reason_, 'priority', priority_)
          FROM robots WHERE id = robot_id_;
      END IF;
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
