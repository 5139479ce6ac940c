// A learner whose answers to fragments are scripted by the test.

#ifndef CRAFTFLEET_TESTS_FAKES_FAKE_LEARNER_SERVICE_H_
#define CRAFTFLEET_TESTS_FAKES_FAKE_LEARNER_SERVICE_H_

#include <deque>
#include <vector>

#include "common/base/mutex.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// Thread-safe.
class FakeLearnerService : public v1::LearnerService::Service {
 public:
  enum class Answer {
    kAccept,
    kDuplicate,
    kExpire,
    kBreak,         // end the stream without a verdict
    kRefuse,        // end it with INVALID_ARGUMENT
    kWrongVerdict,  // on another fragment
    kSilence,       // no answer until the client ends the stream
  };

  // Sets the answers to the next fragments, in order of arrival; later ones are accepted.
  void Script(const std::vector<Answer>& answers) {
    const MutexLock lock(&mu_);
    answers_.assign(answers.begin(), answers.end());
  }
  // The chunks that GetWeights sends.
  void SetWeights(const std::vector<v1::WeightsChunk>& chunks) {
    const MutexLock lock(&mu_);
    chunks_ = chunks;
  }
  std::vector<v1::FragmentMessage> received() const {
    const MutexLock lock(&mu_);
    return received_;
  }

  grpc::Status PushFragments(grpc::ServerContext* /*context*/,
                             grpc::ServerReaderWriter<v1::FragmentVerdict, v1::FragmentMessage>* stream) override {
    v1::FragmentMessage message;
    while (stream->Read(&message)) {
      v1::FragmentVerdict verdict;
      verdict.set_lane(message.lane());
      verdict.set_number(message.number());
      verdict.set_verdict(v1::FragmentVerdict::ACCEPTED);
      switch (Take(message)) {
        case Answer::kAccept:
          break;
        case Answer::kDuplicate:
          verdict.set_verdict(v1::FragmentVerdict::DUPLICATE);
          break;
        case Answer::kExpire:
          verdict.set_verdict(v1::FragmentVerdict::EXPIRED);
          break;
        case Answer::kBreak:
          return {grpc::StatusCode::UNAVAILABLE, "broken off"};
        case Answer::kRefuse:
          return {grpc::StatusCode::INVALID_ARGUMENT, "frames: 1 bytes, want 2"};
        case Answer::kWrongVerdict:
          verdict.set_number(message.number() + 1);
          break;
        case Answer::kSilence:
          continue;
      }
      stream->Write(verdict);
    }
    return grpc::Status::OK;
  }

  grpc::Status GetWeights(grpc::ServerContext* /*context*/, const v1::WeightsRequest* /*request*/,
                          grpc::ServerWriter<v1::WeightsChunk>* writer) override {
    std::vector<v1::WeightsChunk> chunks;
    {
      const MutexLock lock(&mu_);
      chunks = chunks_;
    }
    for (const v1::WeightsChunk& chunk : chunks) writer->Write(chunk);
    return grpc::Status::OK;
  }

 private:
  Answer Take(const v1::FragmentMessage& message) {
    const MutexLock lock(&mu_);
    received_.push_back(message);
    if (answers_.empty()) return Answer::kAccept;
    const Answer answer = answers_.front();
    answers_.pop_front();
    return answer;
  }

  mutable Mutex mu_;
  std::deque<Answer> answers_ ABSL_GUARDED_BY(mu_);
  std::vector<v1::FragmentMessage> received_ ABSL_GUARDED_BY(mu_);
  std::vector<v1::WeightsChunk> chunks_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_FAKE_LEARNER_SERVICE_H_
