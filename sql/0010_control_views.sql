-- The rights that hold since 0008, for relay, web and sshd; and how long the history is kept.

-- The highest level of all grants that hold for a user and a robot, directly or by group and site; admins' included.
-- MAX of an ENUM would compare its texts, hence the numbers.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_grants AS
  WITH held AS (
    SELECT u.id AS user_id, g.robot_id, g.site_id, g.all_robots, g.level + 0 AS height
    FROM grants g
    LEFT JOIN user_group_members m ON m.group_id = g.group_id
    JOIN users u ON u.id = IFNULL(g.user_id, m.user_id) AND NOT u.disabled AND u.role <> 'admin'
    WHERE g.expires_at IS NULL OR g.expires_at > CURRENT_TIMESTAMP(6)
  ), reached AS (
    SELECT user_id, robot_id, height FROM held WHERE robot_id IS NOT NULL
    UNION ALL
    SELECT held.user_id, r.id, held.height FROM held JOIN robots r ON r.site_id = held.site_id
    UNION ALL
    SELECT held.user_id, r.id, held.height FROM held JOIN robots r WHERE held.all_robots
  )
  SELECT user_id, robot_id, ELT(MAX(height), 'observe', 'drive', 'manage') AS level
  FROM reached GROUP BY user_id, robot_id
  UNION ALL
  SELECT u.id, r.id, 'manage' FROM users u JOIN robots r WHERE NOT u.disabled AND u.role = 'admin';

-- As in 0007, by the same rights; but asked for one key a second and more, so it looks at what that key's user
-- may do alone, which the view above cannot. tests/unit/sql/test_views.py holds the two together.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW jump_keys AS
  WITH held AS (
    SELECT k.fingerprint, k.public_key, u.name AS user_name, g.robot_id, g.site_id, g.all_robots
    FROM user_ssh_keys k
    JOIN users u ON u.id = k.user_id AND NOT u.disabled AND u.role <> 'admin'
    JOIN grants g ON g.level = 'manage' AND (g.expires_at IS NULL OR g.expires_at > CURRENT_TIMESTAMP(6))
    LEFT JOIN user_group_members m ON m.group_id = g.group_id AND m.user_id = u.id
    WHERE g.user_id = u.id OR m.user_id = u.id
  ), shells AS (
    SELECT id, site_id, name, shell_port FROM robots WHERE state = 'active' AND shell_port IS NOT NULL
  )
  SELECT h.fingerprint, h.user_name, r.name AS robot, r.shell_port, h.public_key
  FROM held h JOIN shells r ON r.id = h.robot_id
  UNION
  SELECT h.fingerprint, h.user_name, r.name, r.shell_port, h.public_key
  FROM held h JOIN shells r ON r.site_id = h.site_id
  UNION
  SELECT h.fingerprint, h.user_name, r.name, r.shell_port, h.public_key
  FROM held h JOIN shells r WHERE h.all_robots
  UNION
  SELECT k.fingerprint, u.name, r.name, r.shell_port, k.public_key
  FROM user_ssh_keys k JOIN users u ON u.id = k.user_id AND NOT u.disabled AND u.role = 'admin' JOIN shells r;

CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_robots AS
  SELECT r.id, r.name, r.state, r.ros_port, r.video_port, r.settings, r.agent_version, r.updated_at,
    r.shell_port, r.fingerprint, r.previous_fingerprint, r.rotate_requested_at IS NOT NULL AS rotate_key,
    s.name AS site
  FROM robots r LEFT JOIN sites s ON s.id = r.site_id;

-- As in 0003: robots (and sites), users, grants (and groups), tokens, logins. The number of grants that have not
-- ended changes when time ends one.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_changes AS
  SELECT CONCAT_WS('/',
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(r.updated_at)), 0), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(s.created_at)), 0)) FROM sites s)) FROM robots r),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(updated_at)), 0)) FROM users),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(g.updated_at)), 0), ':',
      IFNULL(SUM(g.expires_at IS NULL OR g.expires_at > CURRENT_TIMESTAMP(6)), 0), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(m.created_at)), 0)) FROM user_group_members m)) FROM grants g),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM api_tokens),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM logins)
  ) AS version;

GRANT SELECT ON relay_grants TO 'web'@'%';

-- One row: for how many days audit log, drives and sessions are kept; 0 is for ever, and so is no row.
-- `robotether migrate` writes it from AUDIT_DAYS.
CREATE TABLE IF NOT EXISTS retention (
  id TINYINT UNSIGNED NOT NULL DEFAULT 1 PRIMARY KEY,
  days SMALLINT UNSIGNED NOT NULL,
  CONSTRAINT retention_one CHECK (id = 1)
);

-- Removes what is older, so much at most that no transaction gets long. The newest session of a robot stays,
-- because it tells since when the robot is away; what has not ended stays, too.
CREATE OR REPLACE PROCEDURE prune_history()
BEGIN
  DECLARE days_ INT DEFAULT (SELECT IF(days > 0, days, NULL) FROM retention);
  DECLARE oldest TIMESTAMP(6) DEFAULT CURRENT_TIMESTAMP(6) - INTERVAL days_ DAY;
  DELETE FROM audit_events WHERE at < oldest ORDER BY at LIMIT 50000;
  DELETE FROM drives WHERE ended_at < oldest ORDER BY id LIMIT 50000;
  DELETE FROM robot_sessions WHERE ended_at < oldest
    AND id NOT IN (SELECT id FROM (SELECT MAX(id) AS id FROM robot_sessions GROUP BY robot_id) AS newest)
    ORDER BY ended_at LIMIT 50000;
END;

-- Runs in the database itself (event_scheduler), with the rights of account migrate.
CREATE OR REPLACE EVENT prune_history ON SCHEDULE EVERY 1 HOUR
  COMMENT 'Keeps audit log, drives and sessions for AUDIT_DAYS' DO CALL prune_history();
