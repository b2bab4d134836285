-- How far a cell's clock is ahead of the database's, in seconds; NULL: its relay is older and does not say it. A ticket
-- of a cell whose clock is ahead looks newer than it is.
ALTER TABLE cells ADD COLUMN IF NOT EXISTS clock_ahead_s DOUBLE NULL;
GRANT INSERT (clock_ahead_s), UPDATE (clock_ahead_s) ON cells TO 'relay'@'%';
