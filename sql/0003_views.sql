-- What sshd and the relay may read. The views run with the rights of account migrate, which made them,
-- so their readers need no right to a table.

-- For sshd: who may open a tunnel, and with which ports.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW tunnel_keys AS
  SELECT fingerprint, id AS robot_id, ros_port, video_port, public_key
  FROM robots WHERE state = 'active' AND fingerprint IS NOT NULL;

CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_robots AS
  SELECT id, name, state, ros_port, video_port, settings, agent_version, updated_at FROM robots;

-- The rights that hold, admins' included.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_grants AS
  SELECT g.user_id, g.robot_id, g.level
  FROM grants g JOIN users u ON u.id = g.user_id WHERE NOT u.disabled AND u.role <> 'admin'
  UNION ALL
  SELECT u.id, r.id, 'manage' FROM users u JOIN robots r WHERE NOT u.disabled AND u.role = 'admin';

CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_logins AS
  SELECT l.token_hash, l.user_id, u.name AS user_name, u.role, l.expires_at
  FROM logins l JOIN users u ON u.id = l.user_id
  WHERE NOT u.disabled AND l.expires_at > CURRENT_TIMESTAMP(6);

CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_tokens AS
  SELECT t.token_hash, t.user_id, u.name AS user_name, u.role, t.expires_at
  FROM api_tokens t JOIN users u ON u.id = t.user_id
  WHERE NOT u.disabled AND (t.expires_at IS NULL OR t.expires_at > CURRENT_TIMESTAMP(6));

-- One row, one text that differs whenever one of these tables has changed. A sum and not only the newest
-- moment, because the transaction with the older moment may be the one that commits last.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_changes AS
  SELECT CONCAT_WS('/',
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(updated_at)), 0)) FROM robots),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(updated_at)), 0)) FROM users),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(updated_at)), 0)) FROM grants),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM api_tokens),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM logins)
  ) AS version;

-- For sshd: a refused key leaves one audit line an hour, and all refused keys together at most 60 a minute,
-- so that a robot that keeps trying, or an attacker with many keys, cannot fill the disk. The lock makes
-- count and insert one step; who does not get it within a second goes without a line.
CREATE OR REPLACE PROCEDURE record_refused_key(IN fingerprint VARCHAR(100), IN address VARCHAR(45))
SQL SECURITY DEFINER
BEGIN
  DECLARE held INT DEFAULT GET_LOCK('robotether.refused_key', 1);
  DECLARE moment TIMESTAMP(6) DEFAULT CURRENT_TIMESTAMP(6);
  DECLARE known, recent INT DEFAULT 1000;
  DECLARE EXIT HANDLER FOR SQLEXCEPTION
  BEGIN
    DO RELEASE_LOCK('robotether.refused_key');
    RESIGNAL;
  END;
  IF held = 1 THEN
    SELECT SUM(JSON_VALUE(details, '$.fingerprint') = fingerprint), SUM(at > moment - INTERVAL 1 MINUTE)
      INTO known, recent
      FROM audit_events WHERE kind = 'key_refused' AND at > moment - INTERVAL 1 HOUR;
    IF IFNULL(known, 0) = 0 AND IFNULL(recent, 0) < 60 THEN
      INSERT INTO audit_events (actor, kind, address, details)
        VALUES ('sshd', 'key_refused', NULLIF(address, ''), JSON_OBJECT('fingerprint', fingerprint));
    END IF;
    DO RELEASE_LOCK('robotether.refused_key');
  END IF;
END;
