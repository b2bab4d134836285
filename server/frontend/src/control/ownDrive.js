// Which drive is this page's, by the number of its lease, and that it has ended. Pure.

export class OwnDrive {
  // `onEnded({fence})` comes once for each drive of this page.
  constructor({ me, onEnded }) {
    Object.assign(this, { me, onEnded });
    this.fence = null;
  }

  // What the page's own connection tells of the control. Its first word that names this user means this page:
  // the server gives a drive its number before it opens the connection. A later one may be another window's.
  receive({ driver }, driving) {
    if (this.fence === null && driving && driver?.user === this.me) this.fence = driver.fence;
  }

  // The page's own connection has ended, and with it the drive.
  linkEnded() {
    const { fence } = this;
    this.fence = null;
    if (fence !== null) this.onEnded({ fence });
  }
}
