-- How robots get in, and how people reach a robot's shell. As in 0001, every statement may run twice.

-- shell: whether there is a forward to the robot's own sshd; the triggers of 0006 allot shell_port.
-- previous_fingerprint: the key before the last rotation, whose connections live on.
-- had_key: whether any key ever stood in the row; only without one does JOIN_POLICY=first-key let a key in unseen.
ALTER TABLE robots
  ADD COLUMN IF NOT EXISTS shell BOOLEAN NOT NULL DEFAULT FALSE,
  ADD COLUMN IF NOT EXISTS shell_port SMALLINT UNSIGNED NULL UNIQUE,
  ADD COLUMN IF NOT EXISTS previous_fingerprint VARCHAR(64) NULL,
  ADD COLUMN IF NOT EXISTS rotate_requested_at TIMESTAMP(6) NULL DEFAULT NULL,
  ADD COLUMN IF NOT EXISTS had_key BOOLEAN NOT NULL DEFAULT FALSE;

-- Those that had one before this column was there: a join left a line when it brought one.
-- Stands before the tables because only their CREATE commits it.
UPDATE robots SET had_key = TRUE
  WHERE NOT had_key AND (fingerprint IS NOT NULL OR EXISTS (
    SELECT 1 FROM audit_events e
    WHERE e.robot = robots.name AND e.kind = 'robot_pending' AND e.at > robots.created_at));

-- token_hash is the SHA-256 of the whole text, `rj_` included. created_by is a user's name or `cli`.
CREATE TABLE IF NOT EXISTS join_tokens (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  name VARCHAR(63) NOT NULL UNIQUE,
  token_hash BINARY(32) NOT NULL UNIQUE,
  uses SMALLINT UNSIGNED NOT NULL,
  used SMALLINT UNSIGNED NOT NULL DEFAULT 0,
  created_by VARCHAR(63) NOT NULL,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  expires_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  CONSTRAINT join_tokens_used CHECK (used <= uses)
);

-- Which keys a token has let in: each once. What an admin undid since, the same token does not redo.
CREATE TABLE IF NOT EXISTS join_token_uses (
  token_id INT UNSIGNED NOT NULL,
  fingerprint VARCHAR(64) NOT NULL,
  used_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  PRIMARY KEY (token_id, fingerprint),
  CONSTRAINT join_token_uses_token FOREIGN KEY (token_id) REFERENCES join_tokens (id) ON DELETE CASCADE
);

-- Keys that no robot has: those that wait because the MAC's robot has another one (robot_id; they go with
-- that robot), and those that an admin turned away (rejected_at; they outlive it). robot is its name at that time.
CREATE TABLE IF NOT EXISTS key_claims (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  fingerprint VARCHAR(64) NOT NULL UNIQUE,
  public_key VARCHAR(2048) NOT NULL,
  robot_id INT UNSIGNED NULL,
  robot VARCHAR(63) NOT NULL,
  mac CHAR(17) NOT NULL,
  hostname VARCHAR(253) NULL,
  agent_version VARCHAR(32) NULL,
  address VARCHAR(45) NULL,
  claimed_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  rejected_at TIMESTAMP(6) NULL DEFAULT NULL,
  rejected_by VARCHAR(63) NULL,
  KEY key_claims_claimed_at (claimed_at),
  CONSTRAINT key_claims_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE CASCADE,
  CONSTRAINT key_claims_state CHECK ((robot_id IS NULL) = (rejected_at IS NOT NULL))
);

-- Two users may have one key: it opens what either may reach.
CREATE TABLE IF NOT EXISTS user_ssh_keys (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  user_id INT UNSIGNED NOT NULL,
  name VARCHAR(63) NOT NULL,
  fingerprint VARCHAR(64) NOT NULL,
  public_key VARCHAR(2048) NOT NULL,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  UNIQUE KEY user_ssh_keys_name (user_id, name),
  UNIQUE KEY user_ssh_keys_fingerprint (user_id, fingerprint),
  KEY user_ssh_keys_by_fingerprint (fingerprint),
  CONSTRAINT user_ssh_keys_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE
);
