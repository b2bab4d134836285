// What a person chose on this device, kept for the next visit. A browser that keeps nothing is no error.

const PREFIX = "robotether.";

export class LocalStore {
  constructor(storage = () => globalThis.localStorage) {
    this.storage = storage; // even asking for it throws where it is blocked
  }

  // What was kept under this name, or null.
  read(name) {
    try {
      return JSON.parse(this.storage().getItem(PREFIX + name));
    } catch {
      return null;
    }
  }

  write(name, value) {
    this.attempt((storage) => storage.setItem(PREFIX + name, JSON.stringify(value)));
  }

  forget(name) {
    this.attempt((storage) => storage.removeItem(PREFIX + name));
  }

  attempt(act) {
    try {
      act(this.storage());
    } catch {
      // Full or blocked: the choice then lasts as long as the page.
    }
  }
}
