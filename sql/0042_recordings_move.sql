-- Recordings that go on at another machine. As in 0001, every statement may run twice.

-- Where a robot leaves for another cell, the recorder asks again for what a person had asked for there.
GRANT INSERT (asked_by, asked_by_id) ON recordings TO 'recorder'@'%';
