-- A robot's shell port, allotted and freed as its pair of ports is (0002), and MACs that no robot can have.

-- `robotether migrate` fills this from SHELL_PORT_FIRST and SHELL_PORT_LAST. A deleted robot frees its port.
CREATE TABLE IF NOT EXISTS shell_ports (
  port SMALLINT UNSIGNED NOT NULL PRIMARY KEY,
  robot_id INT UNSIGNED NULL,
  KEY shell_ports_robot (robot_id),
  CONSTRAINT shell_ports_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE SET NULL
);

-- Twin of normalise() in robotether_server/macs.py; tests/unit/server/store/test_robots.py holds the two together.
CREATE OR REPLACE PROCEDURE normalise_mac(IN deed VARCHAR(80), INOUT mac VARCHAR(64))
BEGIN
  DECLARE digits VARCHAR(64) DEFAULT LOWER(TRIM(mac));
  IF digits NOT REGEXP '^([0-9a-f]{1,2}:){5}[0-9a-f]{1,2}\\z|^([0-9a-f]{1,2}-){5}[0-9a-f]{1,2}\\z|^([0-9a-f]{4}[.]){2}[0-9a-f]{4}\\z|^[0-9a-f]{12}\\z' THEN
    CALL refuse_robot(deed, CONCAT(QUOTE(mac), ' is no MAC address; write it as 00:1b:44:11:3a:b7'));
  END IF;
  -- Some systems print 0 for 00.
  SET digits = REGEXP_REPLACE(digits, '(?<![0-9a-f])([0-9a-f])(?![0-9a-f])', '0\\1');
  SET digits = REGEXP_REPLACE(digits, '[:.-]', '');
  IF digits = '000000000000' OR digits REGEXP '^.[13579bdf]' THEN
    CALL refuse_robot(deed, CONCAT(QUOTE(mac),
      ' is no MAC of one robot: it is all zero, broadcast or multicast; give that of its network card'));
  END IF;
  SET mac = TRIM(TRAILING ':' FROM REGEXP_REPLACE(digits, '(..)', '\\1:'));
END;

-- As in 0002, and no port that is kept for shells.
CREATE OR REPLACE PROCEDURE take_ports(
  IN robot_id_ INT UNSIGNED, IN deed VARCHAR(80), IN ros SMALLINT UNSIGNED, IN video SMALLINT UNSIGNED)
BEGIN
  DECLARE owner VARCHAR(64);
  DECLARE locked, kept INT;
  SELECT COUNT(*) INTO locked FROM port_pairs FORCE INDEX (PRIMARY)
    WHERE ros_port IN (ros, ros - 1, video, video - 1) FOR UPDATE;
  SELECT name INTO owner FROM robots
    WHERE id <> robot_id_ AND (ros_port IN (ros, video) OR video_port IN (ros, video)) LIMIT 1;
  IF owner IS NOT NULL THEN
    CALL refuse_robot(deed, CONCAT('robot ', owner, ' has port ', ros, ' or ', video, '; choose others'));
  END IF;
  SELECT COUNT(*) INTO kept FROM shell_ports WHERE port IN (ros, video);
  IF kept > 0 THEN
    CALL refuse_robot(deed, CONCAT('port ', ros, ' or ', video, ' is kept for shells; choose others'));
  END IF;
  UPDATE port_pairs FORCE INDEX (PRIMARY) SET robot_id = robot_id_
    WHERE ros_port IN (ros, ros - 1, video, video - 1) AND robot_id IS NULL;
END;

-- The locking reads and the alias are those of choose_ports in 0002, for the same reasons.
CREATE OR REPLACE PROCEDURE choose_shell_port(
  IN deed VARCHAR(80), IN shell BOOLEAN, INOUT shell_port SMALLINT UNSIGNED)
BEGIN
  DECLARE ports INT;
  IF NOT shell THEN
    SET shell_port = NULL;
  ELSEIF shell_port IS NULL THEN
    SELECT port INTO shell_port FROM shell_ports AS free_ports FORCE INDEX (shell_ports_robot)
      WHERE robot_id IS NULL ORDER BY port LIMIT 1 FOR UPDATE SKIP LOCKED;
    IF shell_port IS NULL THEN
      SELECT port INTO shell_port FROM shell_ports FORCE INDEX (shell_ports_robot)
        WHERE robot_id IS NULL ORDER BY port LIMIT 1 FOR UPDATE;
    END IF;
    IF shell_port IS NULL THEN
      SELECT COUNT(*) INTO ports FROM shell_ports;
      CALL refuse_robot(deed, CONCAT('all ', ports, ' shell ports are in use; ',
        'widen SHELL_PORT_FIRST..SHELL_PORT_LAST in .env, then run migrate'));
    END IF;
  END IF;
END;

-- A port that somebody named must be one of the range, and free.
CREATE OR REPLACE PROCEDURE take_shell_port(
  IN robot_id_ INT UNSIGNED, IN deed VARCHAR(80), IN shell_port SMALLINT UNSIGNED)
BEGIN
  UPDATE shell_ports FORCE INDEX (PRIMARY) SET robot_id = robot_id_
    WHERE port = shell_port AND robot_id IS NULL;
  IF ROW_COUNT() = 0 THEN
    CALL refuse_robot(deed, CONCAT('port ', shell_port, ' is no free shell port; leave shell_port out and one is allotted'));
  END IF;
END;

CREATE OR REPLACE TRIGGER robots_before_insert BEFORE INSERT ON robots FOR EACH ROW
BEGIN
  DECLARE deed VARCHAR(80) DEFAULT CONCAT('add robot ', NEW.name);
  CALL check_robot_name(deed, NEW.name);
  CALL normalise_mac(deed, NEW.mac);
  CALL choose_ports(deed, NEW.ros_port, NEW.video_port);
  CALL choose_shell_port(deed, NEW.shell, NEW.shell_port);
  SET NEW.had_key = NEW.had_key OR NEW.fingerprint IS NOT NULL;
END;

CREATE OR REPLACE TRIGGER robots_after_insert AFTER INSERT ON robots FOR EACH ROW
BEGIN
  CALL take_ports(NEW.id, CONCAT('add robot ', NEW.name), NEW.ros_port, NEW.video_port);
  IF NEW.shell_port IS NOT NULL THEN
    CALL take_shell_port(NEW.id, CONCAT('add robot ', NEW.name), NEW.shell_port);
  END IF;
END;

-- A MAC is looked at only when it changes: rows that an earlier version took in stay as they are.
CREATE OR REPLACE TRIGGER robots_before_update BEFORE UPDATE ON robots FOR EACH ROW
BEGIN
  DECLARE deed VARCHAR(80) DEFAULT CONCAT('change robot ', OLD.name);
  CALL check_robot_name(deed, NEW.name);
  IF NEW.mac <> OLD.mac THEN
    CALL normalise_mac(deed, NEW.mac);
  END IF;
  CALL choose_ports(deed, NEW.ros_port, NEW.video_port);
  CALL choose_shell_port(deed, NEW.shell, NEW.shell_port);
  SET NEW.had_key = NEW.had_key OR NEW.fingerprint IS NOT NULL;
END;

CREATE OR REPLACE TRIGGER robots_after_update AFTER UPDATE ON robots FOR EACH ROW
BEGIN
  IF NEW.ros_port <> OLD.ros_port OR NEW.video_port <> OLD.video_port THEN
    UPDATE port_pairs FORCE INDEX (port_pairs_robot) SET robot_id = NULL WHERE robot_id = NEW.id;
    CALL take_ports(NEW.id, CONCAT('change robot ', OLD.name), NEW.ros_port, NEW.video_port);
  END IF;
  IF NOT NEW.shell_port <=> OLD.shell_port THEN
    UPDATE shell_ports FORCE INDEX (shell_ports_robot) SET robot_id = NULL WHERE robot_id = NEW.id;
    IF NEW.shell_port IS NOT NULL THEN
      CALL take_shell_port(NEW.id, CONCAT('change robot ', OLD.name), NEW.shell_port);
    END IF;
  END IF;
END;
