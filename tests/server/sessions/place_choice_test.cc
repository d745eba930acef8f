#include "server/sessions/place_choice.h"

#include <gtest/gtest.h>

namespace robostress {
namespace {

HeldPlace Place(const std::string& id, const std::string& client, absl::Duration idle) {
  HeldPlace place;
  place.id = id;
  place.client = client;
  place.idle = idle;
  place.attached = place.was_attached = place.learned = true;
  return place;
}

PlaceRules Rules(int places, bool durable) {
  PlaceRules rules;
  rules.places = places;
  rules.durable = durable;
  return rules;
}

TEST(PlaceChoice, WhoNamedASessionAndLeftMakesRoomAtOnce) {
  for (const bool durable : {false, true}) {
    std::vector<HeldPlace> held = {Place("stays", "a", absl::Minutes(14)),
                                   Place("left", "a", absl::ZeroDuration())};
    held[0].idle = durable ? absl::Seconds(5) : absl::Minutes(14);
    held[1].attached = held[1].learned = false;
    EXPECT_EQ(ChoosePlace(Rules(2, durable), held, "a").victim, "left") << durable;
  }
}

TEST(PlaceChoice, WhatLeftHavingLearnedGoesToDiskAtOnceAndOutOfMemoryOnlyWhenAbandoned) {
  std::vector<HeldPlace> held = {Place("left", "a", absl::Seconds(1))};
  held[0].attached = false;
  EXPECT_EQ(ChoosePlace(Rules(1, true), held, "a").victim, "left");
  const PlaceChoice choice = ChoosePlace(Rules(1, false), held, "a");
  EXPECT_EQ(choice.victim, "");
  EXPECT_EQ(choice.wait, absl::Minutes(15) - absl::Seconds(1));
  held[0].idle = absl::Minutes(15);
  EXPECT_EQ(ChoosePlace(Rules(1, false), held, "a").victim, "left");
}

TEST(PlaceChoice, AConnectedRobotThatRestsGoesToDiskAfterSecondsAndKeepsItsMemory) {
  const std::vector<HeldPlace> held = {Place("rests", "a", absl::Seconds(11))};
  EXPECT_EQ(ChoosePlace(Rules(1, true), held, "b").victim, "rests");
  EXPECT_EQ(ChoosePlace(Rules(1, false), held, "b").victim, "");
}

TEST(PlaceChoice, AClientBeyondItsShareGivesUpFirstAndSooner) {
  std::vector<HeldPlace> held;
  for (const char* id : {"a1", "a2", "a3"}) held.push_back(Place(id, "many", absl::Seconds(61)));
  held.push_back(Place("b1", "one", absl::Minutes(14)));
  EXPECT_EQ(ChoosePlace(Rules(4, false), held, "new").victim, "a1")
      << "of three clients one has three of four places: more than two";
  for (HeldPlace& place : held) place.idle = absl::Seconds(50);
  const PlaceChoice choice = ChoosePlace(Rules(4, false), held, "new");
  EXPECT_EQ(choice.victim, "");
  EXPECT_EQ(choice.wait, absl::Seconds(10));
  EXPECT_EQ(ChoosePlace(Rules(4, false), held, "many").victim, "");
}

TEST(PlaceChoice, ASessionThatWasOpenedAndNeverServedWaitsHalfAMinute) {
  std::vector<HeldPlace> held = {Place("opened", "a", absl::Seconds(29))};
  held[0].attached = held[0].was_attached = held[0].learned = false;
  EXPECT_EQ(ChoosePlace(Rules(1, false), held, "a").victim, "");
  EXPECT_EQ(ChoosePlace(Rules(1, false), held, "a").wait, absl::Seconds(1));
  held[0].idle = absl::Seconds(30);
  EXPECT_EQ(ChoosePlace(Rules(1, false), held, "a").victim, "opened");
}

TEST(PlaceChoice, OfEqualsTheOneUnusedForLongest) {
  const std::vector<HeldPlace> held = {Place("x", "a", absl::Minutes(16)),
                                       Place("y", "a", absl::Minutes(18)),
                                       Place("z", "a", absl::Minutes(17))};
  EXPECT_EQ(ChoosePlace(Rules(3, false), held, "a").victim, "y");
}

}  // namespace
}  // namespace robostress
