-- Who drives, who drove, and which robots are stopped. Written by the relay alone; every statement may run twice.

-- The newest lease of each robot. `fence` only ever grows: the guard on the robot refuses what comes with an
-- older one. The row stays when a lease ends (ended_at), so that the number is never given again.
CREATE TABLE IF NOT EXISTS control_leases (
  robot_id INT UNSIGNED NOT NULL PRIMARY KEY,
  fence BIGINT UNSIGNED NOT NULL,
  user_id INT UNSIGNED NULL,
  user_name VARCHAR(63) NOT NULL,
  since TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  ended_at TIMESTAMP(6) NULL DEFAULT NULL,
  CONSTRAINT control_leases_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE CASCADE,
  CONSTRAINT control_leases_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE SET NULL
);

-- One row a lease that reached its robot. Distance, turn and speeds are what was commanded, not what was driven.
-- `refused` counts by kind. The names stay when robot or user are gone. updated_at: the row is written every
-- few seconds while the drive lasts, so that a relay that is killed leaves no more than these out.
CREATE TABLE IF NOT EXISTS drives (
  id BIGINT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  robot_id INT UNSIGNED NULL,
  robot VARCHAR(63) NOT NULL,
  user_name VARCHAR(63) NOT NULL,
  fence BIGINT UNSIGNED NOT NULL,
  started_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  ended_at TIMESTAMP(6) NULL DEFAULT NULL,
  end_code VARCHAR(32) NULL,
  distance_m DOUBLE NOT NULL DEFAULT 0,
  turned_rad DOUBLE NOT NULL DEFAULT 0,
  top_speed_m_s DOUBLE NOT NULL DEFAULT 0,
  top_turn_rad_s DOUBLE NOT NULL DEFAULT 0,
  messages BIGINT UNSIGNED NOT NULL DEFAULT 0,
  dropped_old BIGINT UNSIGNED NOT NULL DEFAULT 0,
  refused JSON NOT NULL DEFAULT '{}',
  stops INT UNSIGNED NOT NULL DEFAULT 0,
  address VARCHAR(45) NULL,
  updated_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6) ON UPDATE CURRENT_TIMESTAMP(6),
  UNIQUE KEY drives_lease (robot_id, fence),
  KEY drives_robot (robot, id),
  KEY drives_user (user_name, id),
  KEY drives_started_at (started_at),
  KEY drives_ended_at (ended_at),
  CONSTRAINT drives_robot_id FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE SET NULL
);

-- A row is a robot that is stopped until a driver releases it.
CREATE TABLE IF NOT EXISTS robot_stops (
  robot_id INT UNSIGNED NOT NULL PRIMARY KEY,
  stopped_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  by_name VARCHAR(63) NOT NULL,
  reason VARCHAR(255) NULL,
  CONSTRAINT robot_stops_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE CASCADE
);

GRANT SELECT, INSERT, UPDATE ON control_leases TO 'relay'@'%';
GRANT SELECT, INSERT, UPDATE ON drives TO 'relay'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON robot_stops TO 'relay'@'%';
GRANT SELECT ON control_leases TO 'web'@'%';
GRANT SELECT ON drives TO 'web'@'%';
GRANT SELECT ON robot_stops TO 'web'@'%';
