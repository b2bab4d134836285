-- What sshd and the relay may read of 0005 and 0006, and what each account may do with it.

CREATE OR REPLACE SQL SECURITY DEFINER VIEW tunnel_keys AS
  SELECT fingerprint, id AS robot_id, ros_port, video_port, public_key, shell_port
  FROM robots WHERE state = 'active' AND fingerprint IS NOT NULL;

-- For sshd's account jump: a row for each key of an enabled user and each active robot with a shell that the user manages.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW jump_keys AS
  SELECT k.fingerprint, u.name AS user_name, r.name AS robot, r.shell_port, k.public_key
  FROM user_ssh_keys k
  JOIN users u ON u.id = k.user_id AND NOT u.disabled
  JOIN robots r ON r.state = 'active' AND r.shell_port IS NOT NULL
  LEFT JOIN grants g ON g.user_id = u.id AND g.robot_id = r.id
  WHERE u.role = 'admin' OR g.level = 'manage';

CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_robots AS
  SELECT id, name, state, ros_port, video_port, settings, agent_version, updated_at,
    shell_port, fingerprint, previous_fingerprint, rotate_requested_at IS NOT NULL AS rotate_key
  FROM robots;

GRANT SELECT, INSERT, UPDATE, DELETE ON join_tokens TO 'web'@'%';
GRANT SELECT, INSERT ON join_token_uses TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON key_claims TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON user_ssh_keys TO 'web'@'%';
GRANT SELECT ON jump_keys TO 'keylookup'@'%';
