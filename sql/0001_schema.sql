-- The records of Robotether. Applied by `robotether migrate` as account migrate.
-- DDL cannot be rolled back, so every statement in these files may run twice: a migration that was cut
-- short is simply applied again. Files are never edited after a release.
-- Moments are TIMESTAMP(6): microseconds, kept in UTC whatever the time zone of a connection.
-- The relay sees changes by watching updated_at, created_at and the number of rows (relay_changes).

CREATE TABLE IF NOT EXISTS users (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  name VARCHAR(63) NOT NULL UNIQUE,
  password_hash VARCHAR(255) NOT NULL,
  role ENUM('admin', 'user') NOT NULL DEFAULT 'user',
  disabled BOOLEAN NOT NULL DEFAULT FALSE,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  updated_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6) ON UPDATE CURRENT_TIMESTAMP(6),
  KEY users_updated_at (updated_at),
  CONSTRAINT users_name CHECK (name REGEXP '^[a-z0-9][a-z0-9._-]*\\z')
);

-- `INSERT INTO robots (mac, name)` is enough to add one: 0002 allots the ports. A robot without a key
-- has not joined yet. The name stands in URLs and is checked by 0002, as is the spelling of the MAC.
-- hostname, agent_version, join_address and joined_at tell of the join that brought the key. stranger: nobody
-- announced the robot, a join made the row, and no admin has had a hand in it since; such rows expire.
CREATE TABLE IF NOT EXISTS robots (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  mac CHAR(17) NOT NULL UNIQUE,
  name VARCHAR(63) NOT NULL UNIQUE,
  state ENUM('pending', 'active', 'disabled') NOT NULL DEFAULT 'pending',
  ros_port SMALLINT UNSIGNED NULL UNIQUE,
  video_port SMALLINT UNSIGNED NULL UNIQUE,
  public_key VARCHAR(2048) NULL,
  fingerprint VARCHAR(64) NULL UNIQUE,
  settings JSON NOT NULL DEFAULT '{}',
  hostname VARCHAR(253) NULL,
  agent_version VARCHAR(32) NULL,
  join_address VARCHAR(45) NULL,
  joined_at TIMESTAMP(6) NULL DEFAULT NULL,
  stranger BOOLEAN NOT NULL DEFAULT FALSE,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  updated_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6) ON UPDATE CURRENT_TIMESTAMP(6),
  KEY robots_updated_at (updated_at),
  KEY robots_state (state),
  CONSTRAINT robots_key CHECK ((public_key IS NULL) = (fingerprint IS NULL))
);

-- Admins need no grant: they manage every robot.
CREATE TABLE IF NOT EXISTS grants (
  user_id INT UNSIGNED NOT NULL,
  robot_id INT UNSIGNED NOT NULL,
  level ENUM('observe', 'drive', 'manage') NOT NULL,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  updated_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6) ON UPDATE CURRENT_TIMESTAMP(6),
  PRIMARY KEY (user_id, robot_id),
  KEY grants_updated_at (updated_at),
  CONSTRAINT grants_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE,
  CONSTRAINT grants_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE CASCADE
);

-- token_hash is the SHA-256 of the whole text, `rt_` included.
CREATE TABLE IF NOT EXISTS api_tokens (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  user_id INT UNSIGNED NOT NULL,
  name VARCHAR(63) NOT NULL,
  token_hash BINARY(32) NOT NULL UNIQUE,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  expires_at TIMESTAMP(6) NULL DEFAULT NULL,
  UNIQUE KEY api_tokens_name (user_id, name),
  CONSTRAINT api_tokens_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE
);

-- token_hash is the SHA-256 of the text in the cookie.
CREATE TABLE IF NOT EXISTS logins (
  token_hash BINARY(32) NOT NULL PRIMARY KEY,
  user_id INT UNSIGNED NOT NULL,
  address VARCHAR(45) NOT NULL,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  expires_at TIMESTAMP(6) NOT NULL,
  KEY logins_expires_at (expires_at),
  CONSTRAINT logins_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE
);

-- Written by the relay alone. A row without ended_at is a robot that is online.
CREATE TABLE IF NOT EXISTS robot_sessions (
  id BIGINT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  robot_id INT UNSIGNED NOT NULL,
  started_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  ended_at TIMESTAMP(6) NULL DEFAULT NULL,
  end_code VARCHAR(32) NULL,
  address VARCHAR(45) NOT NULL,
  agent_version VARCHAR(32) NULL,
  KEY robot_sessions_robot (robot_id, id),
  KEY robot_sessions_ended_at (ended_at),
  CONSTRAINT robot_sessions_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE CASCADE
);

-- Only ever added to. actor is a user's name, `cli`, `relay`, `sshd` or the name that somebody claimed.
CREATE TABLE IF NOT EXISTS audit_events (
  id BIGINT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  actor VARCHAR(63) NOT NULL,
  kind VARCHAR(40) NOT NULL,
  robot VARCHAR(63) NULL,
  address VARCHAR(45) NULL,
  details JSON NOT NULL DEFAULT '{}',
  KEY audit_events_at (at),
  KEY audit_events_kind (kind, at),
  KEY audit_events_actor (actor, kind, at),
  KEY audit_events_robot (robot, at)
);
