-- Which topics a recording lacks. As in 0001, every statement may run twice.

-- topics_left_out: topics of which its file lacks messages for want of room, as JSON; NULL: unknown, as of messages_left_out.
ALTER TABLE recordings ADD COLUMN IF NOT EXISTS topics_left_out MEDIUMTEXT NULL DEFAULT NULL;
GRANT UPDATE (topics_left_out) ON recordings TO 'recorder'@'%';
