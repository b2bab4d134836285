-- Recordings that move between cells, and those of a removed one. As in 0001, every statement may run twice.

-- drivers: all of them. first_asked_at: when a person asked for the first of the recordings that this one continues at
-- another cell; NULL: it continues none.
ALTER TABLE recordings
  MODIFY drivers MEDIUMTEXT NULL,
  ADD COLUMN IF NOT EXISTS first_asked_at TIMESTAMP(6) NULL DEFAULT NULL;
GRANT INSERT (first_asked_at) ON recordings TO 'recorder'@'%';

-- As in 0028, and recordings end.
CREATE OR REPLACE PROCEDURE remove_cell(IN cell_name VARCHAR(63)) SQL SECURITY DEFINER
BEGIN
  DECLARE last_alive TIMESTAMP(6) DEFAULT (SELECT heartbeat_at FROM cells WHERE name = cell_name);
  INSERT INTO audit_events (actor, kind, robot, details)
    SELECT l.user_name, 'drive_ended', r.name, JSON_OBJECT('end_code', 'cell_removed', 'fence', l.fence,
      'at_least_until', DATE_FORMAT(COALESCE(d.ended_at, d.updated_at, l.since), '%Y-%m-%dT%H:%i:%s.%f+00:00'))
    FROM control_leases l JOIN robots r ON r.id = l.robot_id
    LEFT JOIN drives d ON d.robot_id = l.robot_id AND d.fence = l.fence
    WHERE l.ended_at IS NULL AND l.cell = cell_name ORDER BY r.name;
  INSERT INTO audit_events (actor, kind, robot, details)
    SELECT COALESCE(asked_by, 'recorder'), 'recording_ended', robot,
      JSON_OBJECT('end_code', 'cell_removed', 'recording', id)
    FROM recordings WHERE ended_at IS NULL AND cell = cell_name ORDER BY id;
  UPDATE robot_sessions SET ended_at = last_alive, end_code = 'cell_removed' WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE drives SET ended_at = updated_at, end_code = 'cell_removed' WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE recordings SET ended_at = GREATEST(started_at, progress_at), end_code = 'cell_removed'
    WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE control_leases SET ended_at = last_alive WHERE cell = cell_name AND ended_at IS NULL;
  DELETE FROM cells WHERE name = cell_name;
END;
