-- A blank at the end of a text counts: to utf8mb4_bin, which pads texts with blanks to compare them, 'admin ' was 'admin',
-- and to Python it was not. Every text is compared byte by byte from now on. As in 0001, every statement may run twice.

-- For tables that later migrations make.
ALTER DATABASE CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;

ALTER TABLE users CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE robots CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE grants CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE api_tokens CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE logins CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE robot_sessions CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE audit_events CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE join_tokens CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE join_token_uses CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE key_claims CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE user_ssh_keys CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE sites CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE user_groups CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE control_leases CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE drives CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;
ALTER TABLE robot_stops CONVERT TO CHARACTER SET utf8mb4 COLLATE utf8mb4_nopad_bin;

-- As in 0003, made anew: a routine's texts keep the collation that the database had when it was made, and two collations
-- cannot be compared. The other routines compare no text of theirs with a column.
CREATE OR REPLACE PROCEDURE record_refused_key(IN fingerprint VARCHAR(100), IN address VARCHAR(45))
SQL SECURITY DEFINER
BEGIN
  DECLARE held INT DEFAULT GET_LOCK('robotether.refused_key', 1);
  DECLARE moment TIMESTAMP(6) DEFAULT CURRENT_TIMESTAMP(6);
  DECLARE known, recent INT DEFAULT 1000;
  DECLARE EXIT HANDLER FOR SQLEXCEPTION
  BEGIN
    DO RELEASE_LOCK('robotether.refused_key');
    RESIGNAL;
  END;
  IF held = 1 THEN
    SELECT SUM(JSON_VALUE(details, '$.fingerprint') = fingerprint), SUM(at > moment - INTERVAL 1 MINUTE)
      INTO known, recent
      FROM audit_events WHERE kind = 'key_refused' AND at > moment - INTERVAL 1 HOUR;
    IF IFNULL(known, 0) = 0 AND IFNULL(recent, 0) < 60 THEN
      INSERT INTO audit_events (actor, kind, address, details)
        VALUES ('sshd', 'key_refused', NULLIF(address, ''), JSON_OBJECT('fingerprint', fingerprint));
    END IF;
    DO RELEASE_LOCK('robotether.refused_key');
  END IF;
END;

GRANT EXECUTE ON PROCEDURE record_refused_key TO 'keylookup'@'%';
