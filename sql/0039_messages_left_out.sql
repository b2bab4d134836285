-- What a recording lacks. As in 0001, every statement may run twice.

-- messages_left_out: messages of topics for which its file had no room; NULL: unknown, as of a recording of an older recorder,
-- or of one that was killed.
ALTER TABLE recordings ADD COLUMN IF NOT EXISTS messages_left_out BIGINT UNSIGNED NULL DEFAULT NULL;
GRANT UPDATE (messages_left_out) ON recordings TO 'recorder'@'%';
