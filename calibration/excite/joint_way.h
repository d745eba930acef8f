#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace robostress::calibration {

// What a joint may do [rad, rad/s, rad/s^2; of a slide m].
struct JointRoom {
  double centre = 0;            // where every piece begins and ends at rest
  double lower = 0, upper = 0;  // ends of its way, around the centre
  double velocity = 0, acceleration = 0;
};

// One way of moving a joint for a few seconds, from its centre and back.
struct JointPiece {
  enum class Kind {
    kRamps,  // there and back at one speed; `cycles` 0: as often as there is time
    kMoves,  // to one end, the other, and between, as fast as the room allows, with stops
    kSines,  // a Fourier series of five harmonics up to `frequency`, with phases of `seed`
    kChirp,  // a sine from a tenth of `frequency` to it
    kWalk,   // to places, at speeds, and with rests that `seed` draws
    kRest,   // off the centre, still
  };
  Kind kind = Kind::kRest;
  double size = 1;       // share of the way to either end
  double speed = 1;      // share of the most
  double frequency = 0;  // [Hz]
  int side = 1;          // that is gone to first
  uint64_t seed = 0;
  std::string Name() const;  // "ramps at 0.08 of the speed"
};

// What a design chooses from: ramps at five speeds, small turns, moves with stops, sines and chirps
// up to `fastest` [Hz], and rests.
std::vector<JointPiece> PiecePool(double fastest);

// Positions at t = 0, dt, ..., as many as `rows`; the first and the last are the centre. Speed and
// acceleration between rows keep within the room. A piece for which there is no time is smaller.
std::vector<double> SamplePiece(const JointPiece& piece, const JointRoom& room, double dt,
                                int rows);

// The sweep that a lab would play without a design: one sine from 0.1 Hz to `fastest` over all
// rows, at every frequency as large as the room allows. `phase` [rad].
std::vector<double> SampleSweep(const JointRoom& room, double fastest, double phase, double dt,
                                int rows);

}  // namespace robostress::calibration
