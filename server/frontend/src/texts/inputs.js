// Sentences of the pages: what a person drives with. No logic beyond filling in.

const NAMES = "A,B,X,Y,LB,RB,LT,RT,View,Menu,left stick,right stick,up,down,left,right,home".split(",");

// As on most gamepads that the browser knows; else by number, from 1.
export const button = (index, standard) => (standard && NAMES[index] ? `button ${NAMES[index]}` : `button ${index + 1}`);

export const hints = {
  also: (kind) => ` With a keyboard, hold W A S D or the arrow keys${kind === "holonomic" ? ", Q and E to go sideways" : ""}.`,
  // Why keys do not drive, by what has them.
  taken: {
    text: "Keys go to the text field. Press Esc to drive with them.",
    menu: "Arrow keys go to the menu. Press Esc to drive with them.",
    slider: "Arrow keys move the slider. Press Esc to drive with them.",
    held: "Let go of the key and press it again to drive.", // as through a reload
  },
  sticks: {
    one: () => "Joystick: drag to drive, let go to halt.",
    two: (kind) =>
      kind === "holonomic"
        ? "Left joystick: drag to drive forward, back and sideways, let go to halt."
        : "Left joystick: drag up or down to drive, let go to halt.",
    turn: (kind) => (kind === "ackermann" ? "Right joystick: drag to the side to steer." : "Right joystick: drag to the side to turn."),
  },
};

// By the state as of gamepad.js, besides none, lost and learning.
export const gamepad = {
  none: () => "No gamepad found yet. Press any button on it.",
  lost: () => "The gamepad is disconnected. What it drove has stopped.",
  unknown: () => "This gamepad is new here. Set it up to drive with it.",
  off: () => "Gamepad found. It works when you drive.",
  stuck: ({ enable }) => `Release ${enable} first, then hold it to drive.`,
  uncentred: () => "A stick is off its centre, so it drives nothing. Let go of it; if it rests there, widen its dead zone.",
  ready: ({ enable }) => `Gamepad ready. Hold ${enable} to drive.`,
  learning: () => "Setting up the gamepad. Meanwhile it neither drives nor stops the robot.",
};

export const gamepadUse = {
  enable: (name) => `Hold ${name} to drive.`,
  turbo: (name) => (name ? `Hold ${name} too for the turbo limit.` : ""),
  stop: (name) => (name ? `Press ${name} to stop the robot.` : "No button stops the robot; set one up."),
  left: "No stick drives the robot sideways; set one up.",
};

export const learning = {
  rest: () => "Put the gamepad down: let go of all sticks and buttons.",
  move: (step) => MOVES[step],
  back: () => "Good. Let go of it.",
};

const MOVES = {
  forward: "Push the stick that drives forward, and hold it there.",
  left: "Push the stick that drives sideways to the left, and hold it there.",
  turn: "Push the stick that turns to the left, and hold it there.",
  enable: "Press the button that you will hold to drive.",
  turbo: "Press the button for turbo, or skip it.",
  stop: "Press the button that stops the robot, or skip it.",
};

export const percent = (share) => `${Math.round(share * 100)} %`;
