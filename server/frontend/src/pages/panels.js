// What stands below the controls of the drive page: the robot's buttons, its topics, and the summary of a drive.
// Started by drive.js. Observers have the topics alone.

import { rosUrl } from "../client/addresses.js";
import { requestTicket } from "../client/api.js";
import { openLink } from "../client/link.js";
import { Buttons } from "../control/buttonPanel.js";
import { Summary } from "../control/driveSummary.js";
import { OwnDrive } from "../control/ownDrive.js";
import { ObserverConnection } from "../topics/observerConnection.js";
import { Topics } from "../topics/topicList.js";
import { api } from "./calls.js";
import { part } from "./page.js";

// `connection` has `advertise` and `call` as of connection.js; `ask()` has the robot asked for its topics again.
// Gives {topics(list), use({live, driving}), receiveControl(control, driving), linkEnded()}; `receiveControl` is for what the page's own
// connection tells of the control.
export function setUpPanels(root, { robot, user, settings, connection, ask = () => {} }) {
  const requestUrl = async () => rosUrl(location.href, robot, await requestTicket(api, robot, "observe"));
  const observerConnection = new ObserverConnection({ requestUrl, openLink });
  const topics = new Topics(part(root, "topics"), { observerConnection, ask });
  const panels = [topics, ...driversPanels(root, { robot, settings, connection })];
  const summary = panels.find((panel) => panel instanceof Summary);
  const own = new OwnDrive({ me: user, onEnded: (drive) => summary?.driveEnded(drive) });
  return {
    topics: (list) => topics.receive(list),
    use: (now) => panels.forEach((panel) => panel.use(now)),
    receiveControl: (control, driving) => own.receive(control, driving),
    linkEnded: () => own.linkEnded(),
  };
}

function driversPanels(root, { robot, settings, connection }) {
  const buttonPanel = part(root, "buttons");
  if (!buttonPanel) return [];
  const advertise = (spec) => connection.advertise(spec);
  const call = (...how) => connection.call(...how);
  return [
    new Buttons(buttonPanel, { buttons: settings.buttons ?? [], advertise, call }),
    new Summary(part(root, "summary"), { robot }),
  ];
}
