-- Adding a robot by `INSERT INTO robots (mac, name)` alone: the triggers write the MAC in one spelling and
-- allot a free pair of ports. What they refuse they refuse with a sentence (SQLSTATE 45000).

-- A pair is ros_port and the port after it. `robotether migrate` fills this from PORT_RANGE_FIRST and
-- PORT_RANGE_LAST. robot_id names who uses one of the two ports; a deleted robot frees them.
CREATE TABLE IF NOT EXISTS port_pairs (
  ros_port SMALLINT UNSIGNED NOT NULL PRIMARY KEY,
  video_port SMALLINT UNSIGNED AS (ros_port + 1) PERSISTENT,
  robot_id INT UNSIGNED NULL,
  KEY port_pairs_robot (robot_id),
  CONSTRAINT port_pairs_robot FOREIGN KEY (robot_id) REFERENCES robots (id) ON DELETE SET NULL
);

-- `deed` is what the statement is about to do, such as: add robot sim1.
CREATE OR REPLACE PROCEDURE refuse_robot(IN deed VARCHAR(80), IN reason VARCHAR(400))
BEGIN
  DECLARE sentence VARCHAR(500) DEFAULT CONCAT('cannot ', deed, ': ', reason);
  SIGNAL SQLSTATE '45000' SET MESSAGE_TEXT = sentence;
END;

CREATE OR REPLACE PROCEDURE check_robot_name(IN deed VARCHAR(80), IN robot VARCHAR(64))
BEGIN
  IF robot NOT REGEXP '^[a-z0-9]([a-z0-9-]*[a-z0-9])?\\z' THEN
    CALL refuse_robot(deed, 'a name has a-z, 0-9 and -, and neither begins nor ends with -');
  END IF;
END;

-- Twin of robotether_server/macs.py; tests/unit/server/store/test_robots.py holds the two together.
CREATE OR REPLACE PROCEDURE normalise_mac(IN deed VARCHAR(80), INOUT mac VARCHAR(64))
BEGIN
  DECLARE digits VARCHAR(64) DEFAULT LOWER(mac);
  IF digits REGEXP '^([0-9a-f]{2}:){5}[0-9a-f]{2}\\z|^([0-9a-f]{2}-){5}[0-9a-f]{2}\\z|^([0-9a-f]{4}[.]){2}[0-9a-f]{4}\\z|^[0-9a-f]{12}\\z' THEN
    SET mac = TRIM(TRAILING ':' FROM REGEXP_REPLACE(REGEXP_REPLACE(digits, '[:.-]', ''), '(..)', '\\1:'));
  ELSE
    CALL refuse_robot(deed, CONCAT(QUOTE(mac), ' is no MAC address; write it as 00:1b:44:11:3a:b7'));
  END IF;
END;

-- The locking read makes concurrent inserts take different pairs without waiting for one another, and a
-- rollback frees what it took. When all free pairs are locked, the second read waits for their fate.
-- The alias is needed: a trigger opens each table once by name with the strongest lock that any of its
-- statements asks for, and take_ports asks for one that forgets SKIP LOCKED.
CREATE OR REPLACE PROCEDURE choose_ports(
  IN deed VARCHAR(80), INOUT ros SMALLINT UNSIGNED, INOUT video SMALLINT UNSIGNED)
BEGIN
  DECLARE pairs INT;
  IF ros IS NULL AND video IS NULL THEN
    SELECT ros_port INTO ros FROM port_pairs AS free_pairs FORCE INDEX (port_pairs_robot)
      WHERE robot_id IS NULL ORDER BY ros_port LIMIT 1 FOR UPDATE SKIP LOCKED;
    IF ros IS NULL THEN
      SELECT ros_port INTO ros FROM port_pairs FORCE INDEX (port_pairs_robot)
        WHERE robot_id IS NULL ORDER BY ros_port LIMIT 1 FOR UPDATE;
    END IF;
    IF ros IS NULL THEN
      SELECT COUNT(*) INTO pairs FROM port_pairs;
      CALL refuse_robot(deed, CONCAT('all ', pairs, ' port pairs are in use; ',
        'widen PORT_RANGE_FIRST..PORT_RANGE_LAST in .env, then run migrate'));
    END IF;
    SET video = ros + 1;
  ELSEIF ros IS NULL OR video IS NULL OR ros = video OR ros < 1024 OR video < 1024 THEN
    CALL refuse_robot(deed,
      'give two different ports from 1024 to 65535, or neither and a free pair is allotted');
  END IF;
END;

-- Ports that somebody named may lie anywhere, so they may touch up to two pairs, and may be the other kind
-- of port of another robot, which the unique keys of the table do not see.
CREATE OR REPLACE PROCEDURE take_ports(
  IN robot_id_ INT UNSIGNED, IN deed VARCHAR(80), IN ros SMALLINT UNSIGNED, IN video SMALLINT UNSIGNED)
BEGIN
  DECLARE owner VARCHAR(64);
  DECLARE locked INT;
  SELECT COUNT(*) INTO locked FROM port_pairs FORCE INDEX (PRIMARY)
    WHERE ros_port IN (ros, ros - 1, video, video - 1) FOR UPDATE;
  SELECT name INTO owner FROM robots
    WHERE id <> robot_id_ AND (ros_port IN (ros, video) OR video_port IN (ros, video)) LIMIT 1;
  IF owner IS NOT NULL THEN
    CALL refuse_robot(deed, CONCAT('robot ', owner, ' has port ', ros, ' or ', video, '; choose others'));
  END IF;
  UPDATE port_pairs FORCE INDEX (PRIMARY) SET robot_id = robot_id_
    WHERE ros_port IN (ros, ros - 1, video, video - 1) AND robot_id IS NULL;
END;

CREATE OR REPLACE TRIGGER robots_before_insert BEFORE INSERT ON robots FOR EACH ROW
BEGIN
  DECLARE deed VARCHAR(80) DEFAULT CONCAT('add robot ', NEW.name);
  CALL check_robot_name(deed, NEW.name);
  CALL normalise_mac(deed, NEW.mac);
  CALL choose_ports(deed, NEW.ros_port, NEW.video_port);
END;

CREATE OR REPLACE TRIGGER robots_after_insert AFTER INSERT ON robots FOR EACH ROW
BEGIN
  CALL take_ports(NEW.id, CONCAT('add robot ', NEW.name), NEW.ros_port, NEW.video_port);
END;

CREATE OR REPLACE TRIGGER robots_before_update BEFORE UPDATE ON robots FOR EACH ROW
BEGIN
  DECLARE deed VARCHAR(80) DEFAULT CONCAT('change robot ', OLD.name);
  CALL check_robot_name(deed, NEW.name);
  CALL normalise_mac(deed, NEW.mac);
  CALL choose_ports(deed, NEW.ros_port, NEW.video_port);
END;

CREATE OR REPLACE TRIGGER robots_after_update AFTER UPDATE ON robots FOR EACH ROW
BEGIN
  IF NEW.ros_port <> OLD.ros_port OR NEW.video_port <> OLD.video_port THEN
    UPDATE port_pairs FORCE INDEX (port_pairs_robot) SET robot_id = NULL WHERE robot_id = NEW.id;
    CALL take_ports(NEW.id, CONCAT('change robot ', OLD.name), NEW.ros_port, NEW.video_port);
  END IF;
END;
