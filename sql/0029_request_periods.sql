-- Figures of requests over time: web counts what was made when, and knows from when on all is still there.
ALTER TABLE help_requests ADD INDEX IF NOT EXISTS help_requests_created_at (created_at);

GRANT SELECT ON retention TO 'web'@'%';
