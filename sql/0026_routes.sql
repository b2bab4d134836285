-- Routes between robots (docs/adr/0051-routes-drive-with-the-lease.md).

-- Each takes a topic of one robot to a topic of another. Written by web, but for ended_at and end_code: the relay ends a
-- route when its maker's right, a stop or somebody who takes control does, and no route ended comes back. ends_at: until
-- when it was made; NULL: until somebody removes it.
CREATE TABLE IF NOT EXISTS routes (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  source_id INT UNSIGNED NOT NULL,
  source_topic VARCHAR(255) NOT NULL,
  target_id INT UNSIGNED NOT NULL,
  target_topic VARCHAR(255) NOT NULL,
  type VARCHAR(255) NOT NULL,
  rate_hz DOUBLE NOT NULL,
  user_id INT UNSIGNED NOT NULL,
  made_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  ends_at TIMESTAMP(6) NULL DEFAULT NULL,
  ended_at TIMESTAMP(6) NULL DEFAULT NULL,
  end_code VARCHAR(32) NULL,
  CONSTRAINT routes_source FOREIGN KEY (source_id) REFERENCES robots (id) ON DELETE CASCADE,
  CONSTRAINT routes_target FOREIGN KEY (target_id) REFERENCES robots (id) ON DELETE CASCADE,
  CONSTRAINT routes_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE,
  CONSTRAINT routes_ends CHECK (source_id <> target_id)
);

-- Those that have not ended, with their makers' names, for relays.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_routes AS
  SELECT r.id, r.source_id, r.source_topic, r.target_id, r.target_topic, r.type, r.rate_hz, r.user_id,
    u.name AS user_name, r.ends_at
  FROM routes r JOIN users u ON u.id = r.user_id
  WHERE r.ended_at IS NULL AND (r.ends_at IS NULL OR r.ends_at > CURRENT_TIMESTAMP(6));

GRANT SELECT, INSERT, DELETE ON routes TO 'web'@'%';
GRANT SELECT (id, ended_at), UPDATE (ended_at, end_code) ON routes TO 'relay'@'%';
GRANT SELECT ON relay_routes TO 'relay'@'%';
