-- Joins that were refused, for the page that adds a robot: one row for each MAC and network, the newest alone, few of each
-- network and for a day. `host_key_changed`: it is in, and refuses the host key that it gets from SSH.
CREATE TABLE IF NOT EXISTS refused_joins (
  mac CHAR(17) NOT NULL,
  network VARCHAR(49) NOT NULL,
  fingerprint VARCHAR(64) NOT NULL,
  hostname VARCHAR(253) NOT NULL,
  agent_version VARCHAR(32) NOT NULL,
  address VARCHAR(45) NOT NULL,
  code VARCHAR(50) NOT NULL,
  detail VARCHAR(1000) NOT NULL,
  times INT UNSIGNED NOT NULL DEFAULT 1,
  refused_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  PRIMARY KEY (mac, network),
  KEY refused_joins_network (network, refused_at)
);

-- As in 0019, and the robots that refuse the server's host key since their last session.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW other_keys AS
  SELECT robot_id, ELT(MIN(worth), 'host_key', 'waiting', 'rejected') AS state
  FROM (
    SELECT r.id AS robot_id, 1 AS worth FROM refused_joins j JOIN robots r ON r.mac = j.mac AND r.fingerprint = j.fingerprint
    WHERE j.code = 'host_key_changed'
      AND NOT EXISTS (SELECT 1 FROM robot_sessions s WHERE s.robot_id = r.id AND s.started_at > j.refused_at)
    UNION ALL
    SELECT c.robot_id, 2 FROM key_claims c WHERE c.robot_id IS NOT NULL
    UNION ALL
    SELECT r.id, 3 FROM key_claims c JOIN robots r ON r.mac = c.mac AND r.name = c.robot
    WHERE c.rejected_at > COALESCE(r.joined_at, r.created_at)
  ) AS shown
  GROUP BY robot_id;

-- As in 0019, and refused host keys.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_changes AS
  SELECT CONCAT_WS('/',
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(r.updated_at)), 0), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(s.created_at)), 0)) FROM sites s), ':', (
      SELECT CONCAT(COUNT(*), ':', COUNT(c.rejected_at), ':', IFNULL(SUM(c.id), 0)) FROM key_claims c), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(j.refused_at)), 0)) FROM refused_joins j
      WHERE j.code = 'host_key_changed')) FROM robots r),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(updated_at)), 0)) FROM users),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(g.updated_at)), 0), ':',
      IFNULL(SUM(g.expires_at IS NULL OR g.expires_at > CURRENT_TIMESTAMP(6)), 0), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(m.created_at)), 0)) FROM user_group_members m)) FROM grants g),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM api_tokens),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM logins)
  ) AS version;

GRANT SELECT, INSERT, UPDATE, DELETE ON refused_joins TO 'web'@'%';
