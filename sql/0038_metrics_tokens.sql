-- API tokens that read the metrics and do nothing else: Prometheus keeps one on its disk.

-- NULL: it may do what its user may do. The hash of any other token is not that of its text (db/credentials.py), so that
-- whoever looks for a token of all rights, a version before this one too, never finds it.
ALTER TABLE api_tokens ADD COLUMN IF NOT EXISTS only_for ENUM('metrics') NULL DEFAULT NULL;
