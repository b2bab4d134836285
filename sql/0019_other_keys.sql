-- Whether a machine with a robot's MAC showed another key since the robot's own came: one of the reasons why it is offline.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW other_keys AS
  SELECT robot_id, IF(MAX(waits), 'waiting', 'rejected') AS state
  FROM (
    SELECT c.robot_id, TRUE AS waits FROM key_claims c WHERE c.robot_id IS NOT NULL
    UNION ALL
    SELECT r.id, FALSE FROM key_claims c JOIN robots r ON r.mac = c.mac AND r.name = c.robot
    WHERE c.rejected_at > COALESCE(r.joined_at, r.created_at)
  ) AS shown
  GROUP BY robot_id;

CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_robots AS
  SELECT r.id, r.name, r.state, r.ros_port, r.video_port, r.settings, r.agent_version, r.updated_at,
    r.shell_port, r.fingerprint, r.previous_fingerprint, r.rotate_requested_at IS NOT NULL AS rotate_key,
    s.name AS site, o.state AS other_key
  FROM robots r LEFT JOIN sites s ON s.id = r.site_id LEFT JOIN other_keys o ON o.robot_id = r.id;

-- As in 0010: robots (with sites and the keys that wait or were rejected), users, grants (and groups), tokens, logins.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_changes AS
  SELECT CONCAT_WS('/',
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(r.updated_at)), 0), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(s.created_at)), 0)) FROM sites s), ':', (
      SELECT CONCAT(COUNT(*), ':', COUNT(c.rejected_at), ':', IFNULL(SUM(c.id), 0)) FROM key_claims c)) FROM robots r),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(updated_at)), 0)) FROM users),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(g.updated_at)), 0), ':',
      IFNULL(SUM(g.expires_at IS NULL OR g.expires_at > CURRENT_TIMESTAMP(6)), 0), ':', (
      SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(m.created_at)), 0)) FROM user_group_members m)) FROM grants g),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM api_tokens),
    (SELECT CONCAT(COUNT(*), ':', IFNULL(SUM(UNIX_TIMESTAMP(created_at)), 0)) FROM logins)
  ) AS version;

GRANT SELECT ON other_keys TO 'web'@'%';
