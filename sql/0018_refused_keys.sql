-- Refused keys of strangers: within an hour at most 10 lines of one network (an address, or a /64 of IPv6) and 60 of all,
-- kept for 30 days. A further refusal is counted in the newest line of its key or network as `more`, and where there is
-- none in the newest line of all as `elsewhere`.
CREATE OR REPLACE PROCEDURE record_refused_key(IN fingerprint VARCHAR(100), IN address VARCHAR(45))
SQL SECURITY DEFINER
BEGIN
  DECLARE held INT DEFAULT GET_LOCK('robotether.refused_key', 1);
  DECLARE network VARBINARY(16) DEFAULT IF(address LIKE '%:%', LEFT(INET6_ATON(address), 8), INET6_ATON(address));
  DECLARE of_key, of_network, newest BIGINT UNSIGNED DEFAULT NULL;
  DECLARE network_lines, all_lines INT DEFAULT 0;
  DECLARE EXIT HANDLER FOR SQLEXCEPTION
  BEGIN
    DO RELEASE_LOCK('robotether.refused_key');
    RESIGNAL;
  END;
  IF held = 1 THEN
    -- Without a derived table: MariaDB refuses such a SELECT when a connection calls the procedure again.
    SELECT MAX(IF(JSON_VALUE(e.details, '$.fingerprint') <=> fingerprint, e.id, NULL)),
        MAX(IF(IF(e.address LIKE '%:%', LEFT(INET6_ATON(e.address), 8), INET6_ATON(e.address)) <=> network, e.id, NULL)),
        MAX(e.id),
        SUM(IF(e.address LIKE '%:%', LEFT(INET6_ATON(e.address), 8), INET6_ATON(e.address)) <=> network),
        COUNT(*)
      INTO of_key, of_network, newest, network_lines, all_lines
      FROM audit_events e WHERE e.kind = 'key_refused' AND e.at > CURRENT_TIMESTAMP(6) - INTERVAL 1 HOUR;
    IF of_key IS NULL AND IFNULL(network_lines, 0) < 10 AND all_lines < 60 THEN
      INSERT INTO audit_events (actor, kind, address, details)
        VALUES ('sshd', 'key_refused', NULLIF(address, ''), JSON_OBJECT('fingerprint', fingerprint));
    ELSEIF COALESCE(of_key, of_network) IS NOT NULL THEN
      UPDATE audit_events SET details = JSON_SET(details, '$.more', CAST(IFNULL(JSON_VALUE(details, '$.more'), 0) AS UNSIGNED) + 1)
        WHERE id = COALESCE(of_key, of_network);
    ELSE
      UPDATE audit_events SET details = JSON_SET(details, '$.elsewhere', CAST(IFNULL(JSON_VALUE(details, '$.elsewhere'), 0) AS UNSIGNED) + 1)
        WHERE id = newest;
    END IF;
    DO RELEASE_LOCK('robotether.refused_key');
  END IF;
END;

GRANT EXECUTE ON PROCEDURE record_refused_key TO 'keylookup'@'%';

-- As in 0010, and what strangers left after 30 days.
CREATE OR REPLACE PROCEDURE prune_history()
BEGIN
  DECLARE days_ INT DEFAULT (SELECT IF(days > 0, days, NULL) FROM retention);
  DECLARE oldest TIMESTAMP(6) DEFAULT CURRENT_TIMESTAMP(6) - INTERVAL days_ DAY;
  DELETE FROM audit_events WHERE at < oldest ORDER BY at LIMIT 50000;
  DELETE FROM audit_events WHERE kind = 'key_refused' AND at < CURRENT_TIMESTAMP(6) - INTERVAL 30 DAY ORDER BY at LIMIT 50000;
  DELETE FROM drives WHERE ended_at < oldest ORDER BY id LIMIT 50000;
  DELETE FROM robot_sessions WHERE ended_at < oldest
    AND id NOT IN (SELECT id FROM (SELECT MAX(id) AS id FROM robot_sessions GROUP BY robot_id) AS newest)
    ORDER BY ended_at LIMIT 50000;
END;
