-- Recordings of robots: one row each, whose file is named by the row's id.

-- Three writers, each of its own columns. web writes what a person asks: `asked_...`, `stop_...`, `delete_...` and
-- `download...`. The recorder writes all others, and inserts rows for robots that are recorded by their settings (`cause`).
-- robot and asked_by: names as they were, for people; rights go by the numbers. cell: whose recorder has the file.
-- progress_at: when the recorder last wrote; it writes every few seconds. bytes and messages: so far, then in all.
CREATE TABLE IF NOT EXISTS recordings (
  id BIGINT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  robot_id INT UNSIGNED NOT NULL,
  robot VARCHAR(63) NOT NULL,
  cause ENUM('asked', 'driven', 'always', 'on_stop') NOT NULL,
  asked_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  asked_by_id INT UNSIGNED NULL,
  asked_by VARCHAR(63) NULL,
  stop_requested_at TIMESTAMP(6) NULL DEFAULT NULL,
  delete_requested_at TIMESTAMP(6) NULL DEFAULT NULL,
  downloaded_at TIMESTAMP(6) NULL DEFAULT NULL,
  downloaded_by_id INT UNSIGNED NULL,
  cell VARCHAR(63) NULL,
  started_at TIMESTAMP(6) NULL DEFAULT NULL,
  ended_at TIMESTAMP(6) NULL DEFAULT NULL,
  end_code VARCHAR(32) NULL,
  drivers VARCHAR(255) NULL,
  bytes BIGINT UNSIGNED NOT NULL DEFAULT 0,
  messages BIGINT UNSIGNED NOT NULL DEFAULT 0,
  progress_at TIMESTAMP(6) NULL DEFAULT NULL,
  deleted_at TIMESTAMP(6) NULL DEFAULT NULL,
  KEY recordings_robot (robot_id, id),
  KEY recordings_ended (ended_at),
  KEY recordings_deleted (deleted_at)
);

-- Robots that may be recorded; recording_when: by their settings, NULL as never. cameras: those of the drive page, as JSON.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW recorder_robots AS
  SELECT r.id, r.name, JSON_VALUE(r.settings, '$.recording.when') AS recording_when,
    JSON_EXTRACT(r.settings, '$.page.cameras[*].topic') AS cameras
  FROM robots r WHERE r.state = 'active';

GRANT SELECT,
  INSERT (robot_id, robot, cause, asked_at, asked_by_id, asked_by),
  UPDATE (stop_requested_at, delete_requested_at, downloaded_at, downloaded_by_id)
  ON recordings TO 'web'@'%';
GRANT SELECT,
  INSERT (robot_id, robot, cause, cell, started_at, progress_at),
  UPDATE (cell, started_at, ended_at, end_code, drivers, bytes, messages, progress_at, deleted_at)
  ON recordings TO 'recorder'@'%';
GRANT SELECT ON recorder_robots TO 'recorder'@'%';
GRANT SELECT ON relay_grants TO 'recorder'@'%';
GRANT INSERT ON audit_events TO 'recorder'@'%';

-- What is deleted is kept as long as the audit log that tells of it.
CREATE OR REPLACE EVENT prune_recordings ON SCHEDULE EVERY 1 HOUR
  COMMENT 'Keeps the rows of deleted recordings for AUDIT_DAYS' DO
  DELETE FROM recordings WHERE deleted_at < CURRENT_TIMESTAMP(6) - INTERVAL (SELECT IF(days > 0, days, NULL) FROM retention) DAY
  ORDER BY deleted_at LIMIT 50000;
