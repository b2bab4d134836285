// What a robot's sensor_msgs/BatteryState says to a person. Pure.

const LOW_PERCENT = 20;
const CHARGING = 1;
const FULL = 4;

export class BatteryReader {
  // Gives {percent, volts, charging, low}, percent and volts null where the message does not tell, or null for no battery at all.
  read({ percentage, voltage, power_supply_status: status, present }) {
    if (present === false) return null;
    const percent = this.percent(percentage);
    const volts = Number.isFinite(voltage) && voltage > 0 ? Math.round(voltage * 10) / 10 : null;
    if (percent === null && volts === null) return null;
    const charging = status === CHARGING || status === FULL;
    return { percent, volts, charging, low: percent !== null && percent < LOW_PERCENT };
  }

  // 0 to 1 by its definition. Drivers that count to 100 are many: one that was over 1 once means hundredths from then on.
  percent(percentage) {
    if (!Number.isFinite(percentage) || percentage < 0 || percentage > 100) return null;
    this.hundredths ||= percentage > 1;
    return Math.round(this.hundredths ? percentage : percentage * 100);
  }
}
