// Load cell with an HX711 amplifier on an Arduino Nano or Uno: prints each sample as raw counts, one number on a line.
//
//   HX711   board
//   VCC     5V
//   GND     GND
//   SCK     D2
//   DT      D3
//
// The amplifier sends 10 or 80 samples per second; its RATE pin decides. Use 80 (RATE connected to VCC).
// The counts rise or fall by steps of 1 in 2^24, and are converted to newtons by `tacbench rig calibrate-force`.

const uint8_t CLOCK_PIN = 2;
const uint8_t DATA_PIN = 3;
const uint8_t BITS = 24;

// 25 pulses read a sample, and select channel A with the gain 128 for the next one.
const uint8_t PULSES = BITS + 1;

void setup() {
  pinMode(CLOCK_PIN, OUTPUT);
  digitalWrite(CLOCK_PIN, LOW);
  // With the pull-up, a wire that came off reads as "no sample yet": the board is silent, and the computer notices it.
  pinMode(DATA_PIN, INPUT_PULLUP);
  Serial.begin(115200);
}

int32_t sample() {
  uint32_t counts = 0;
  for (uint8_t pulse = 0; pulse < PULSES; ++pulse) {
    // The amplifier switches itself off if the clock stays high for 60 microseconds, so nothing may interrupt a pulse.
    noInterrupts();
    digitalWrite(CLOCK_PIN, HIGH);
    delayMicroseconds(1);
    const bool bit = digitalRead(DATA_PIN) == HIGH;
    digitalWrite(CLOCK_PIN, LOW);
    interrupts();
    if (pulse < BITS) counts = counts << 1 | bit;
  }
  // The sign bit fills the upper eight bits.
  if (counts & 0x800000UL) counts |= 0xFF000000UL;
  return static_cast<int32_t>(counts);
}

void loop() {
  if (digitalRead(DATA_PIN) == LOW) Serial.println(sample());
}
