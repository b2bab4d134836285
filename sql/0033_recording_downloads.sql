-- Who has downloaded a recording, and when that began: the audit log gets one line a person, recording and hour, whatever
-- the number of pieces, and of people who read in turn. `download...` of recordings knew the last person alone, and is unused.
CREATE TABLE IF NOT EXISTS recording_downloads (
  recording_id BIGINT UNSIGNED NOT NULL,
  user_id INT UNSIGNED NOT NULL,
  begun_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  PRIMARY KEY (recording_id, user_id),
  FOREIGN KEY (recording_id) REFERENCES recordings (id) ON DELETE CASCADE
);
GRANT SELECT, INSERT, UPDATE ON recording_downloads TO 'web'@'%';
